"""The rows of ``residuals.csv``: every observation with its residual, or the reason why it has none."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.observations.observations import BeamSpots
from calibration.heliostat.observations.residuals import Residuals, evaluate, predicted_spots
from heliogauge.geometry.sun import angles_from_direction
from heliogauge.validate import FloatArray


def final_flags(result: HeliostatResult) -> tuple[list[str], list[str]]:
    """Return flag and reason of every row, those that the fit refused included.

    Returns: Flags, keys of `calibration.heliostat.observations.rows.ROW_FLAGS`.
    """
    rows, fit = result.seen.rows, result.fit
    flags, reasons = list(rows.flags), list(rows.reasons)
    for place, row in enumerate(fit.observations.row.tolist()):
        if fit.rejected[place]:
            flags[row] = "outlier" if fit.residuals.computable[place] else "reading"
            reasons[row] = fit.reason[place]
    return flags, reasons


def residual_columns(result: HeliostatResult, shared: Shared) -> dict[str, Sequence[Any] | npt.NDArray[Any]]:
    """Return the columns of ``residuals.csv``, one row for every row that was read.

    Returns: Columns; NaN where a row has no such number. ``residual_*`` are measured minus predicted by the fit to
        the train rows of the split, so that those of test rows are true predictions; ``all_rows_*`` by the fit to
        all.
    """
    seen, rows, fit = result.seen, result.seen.rows, result.fit
    count, place = len(rows), fit.observations.row
    main = result.main
    trained = fit if main is None else main.fit
    tried_on_all = main is not None and (main.split.train | main.split.test).all()
    residuals = main.residuals if main is not None and tried_on_all else _evaluated(trained, fit)
    flags, reasons = final_flags(result)
    azimuth, elevation = angles_from_direction(seen.suns)
    measured, predicted = _on_targets(result, shared, trained, count)

    def spread(values: npt.ArrayLike) -> FloatArray:
        column = np.full(count, np.nan)
        column[place] = values
        return column

    splits = [""] * count
    if main is not None:
        for row, train, test in zip(place.tolist(), main.split.train, main.split.test, strict=True):
            splits[row] = "train" if train else "test" if test else ""
    beam, normal = 1e3 * residuals.beam_rad, 1e3 * residuals.normal_rad
    return {
        "observation": rows.ids,
        "time_utc": ["" if np.isnat(time) else f"{time}Z" for time in rows.times],
        "kind": rows.text("kind", "beam"),
        "target": _labels(result),
        "image": rows.text("image"),
        "split": splits,
        f"axis_1_{fit.design.reading_unit}": seen.readings[:, 0],
        f"axis_2_{fit.design.reading_unit}": seen.readings[:, 1],
        "sun_azimuth_deg": np.rad2deg(azimuth),
        "sun_elevation_deg": np.rad2deg(elevation),
        "measured_x_m": measured[:, 0],
        "measured_y_m": measured[:, 1],
        "predicted_x_m": predicted[:, 0],
        "predicted_y_m": predicted[:, 1],
        "residual_right_mrad": spread(beam[:, 0]),
        "residual_up_mrad": spread(beam[:, 1]),
        "residual_beam_mrad": spread(1e3 * residuals.beam_angle_rad),
        "residual_normal_right_mrad": spread(normal[:, 0]),
        "residual_normal_up_mrad": spread(normal[:, 1]),
        "residual_normal_mrad": spread(1e3 * residuals.normal_angle_rad),
        "sigma_mrad": spread(1e3 * fit.residuals.sigma_beam_rad * fit.factor),
        "predicted_sigma_mrad": _predicted_sigmas(result, count),
        "all_rows_residual_beam_mrad": spread(1e3 * fit.residuals.beam_angle_rad),
        "all_rows_residual_normal_mrad": spread(1e3 * fit.residuals.normal_angle_rad),
        "weight": spread(fit.weight),
        "leverage": spread(fit.leverage),
        "distance_m": spread(fit.residuals.distance_m),
        "flag": flags,
        "reason": reasons,
    }


def _evaluated(trained: HeliostatFit, fit: HeliostatFit) -> Residuals:
    if trained is fit:
        return fit.residuals
    design = trained.design
    extra = fit.observations.extra_parameters(design)
    if len(extra):
        design = design.with_parameters(design.parameters.extended(extra))
    return evaluate(design, design.parameters.values, fit.observations, columns=[0])


def _labels(result: HeliostatResult) -> list[str]:
    rows = result.seen.rows
    labels = [target or camera for target, camera in zip(rows.text("target"), rows.text("camera"), strict=True)]
    for row, label in zip(result.fit.observations.row.tolist(), result.fit.observations.label, strict=True):
        labels[row] = labels[row] or label
    return labels


def _on_targets(
    result: HeliostatResult, shared: Shared, trained: HeliostatFit, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return where each beam was, and where the trained model puts it, on its target (n, 2) [m]."""
    measured, predicted = np.full((count, 2), np.nan), np.full((count, 2), np.nan)
    targets, named = shared.plant.targets, np.array(result.seen.rows.text("target"), dtype=np.str_)
    for name in set(named.tolist()) & set(targets):
        mine = named == name
        measured[mine] = targets[name].coordinates(result.seen.spots_m[mine])
    for group in result.fit.observations.groups:
        if isinstance(group, BeamSpots) and len(group):
            predicted[group.pointings.row] = predicted_spots(
                trained.design, trained.design.parameters.values, group, targets
            )
    return measured, predicted


def _predicted_sigmas(result: HeliostatResult, count: int) -> FloatArray:
    column = np.full(count, np.nan)
    main = result.main
    if main is not None:
        rows = result.fit.observations.row[np.asarray(main.split.test, dtype=np.bool_)]
        column[rows] = 1e3 * main.prediction.sigma_beam_rad
    return column
