"""Results of heliostats on disk: ``heliostat.json``, ``residuals.csv``, ``summary.json``, ``field.csv``."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.heliostat.files.result import FIELD, HeliostatResult, Shared
from calibration.heliostat.files.store_residuals import final_flags, residual_columns
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.splits import AngleSummary, HeldOut
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.store_design import design_content
from heliogauge.doubts import doubt_content
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site
from heliogauge.results.folder import Summary
from heliogauge.results.json_file import json_text, read_json
from heliogauge.results.tables import table_lines
from heliogauge.validate import FloatArray

HELIOSTAT_FILE = "heliostat.json"
#: The model without the remedy, where one was applied.
AS_STATED_FILE = "heliostat_as_stated.json"
AS_STATED = "as stated, without the remedy"
RESIDUALS_FILE = "residuals.csv"
KIND = "heliostat"
SCHEMA = 1


def heliostat_texts(result: HeliostatResult, shared: Shared) -> dict[str, str]:
    """Return what ``heliostat.json`` and ``residuals.csv`` of one heliostat hold, by the names of the files."""
    texts = {HELIOSTAT_FILE: json_text(HELIOSTAT_FILE, heliostat_content(result, shared))}
    if result.as_stated is not None:
        # Nothing was tried out with what is known to be wrong.
        stated = replace(result, fit=result.as_stated, free=AS_STATED, held={}, not_split={}, choice=None, sky=None)
        texts[AS_STATED_FILE] = json_text(AS_STATED_FILE, heliostat_content(stated, shared))
    return texts | {RESIDUALS_FILE: "".join(table_lines(RESIDUALS_FILE, residual_columns(result, shared)))}


def heliostat_content(result: HeliostatResult, shared: Shared) -> dict[str, Any]:
    """Return the content of ``heliostat.json``.

    shared: What all heliostats of the run share.
    Returns: Only numbers, texts, lists and tables; null where something is not determined.
    """
    fit = result.fit
    free = [fit.names.index(name) for name in fit.solution.names]
    plant = shared.plant
    return {
        "schema_version": SCHEMA,
        "heliostat": result.name,
        "site": {
            "latitude_deg": plant.origin[0],
            "longitude_deg": plant.origin[1],
            "altitude_m": plant.origin[2],
            "pressure_hpa": plant.site.pressure_hpa,
            "temperature_c": plant.site.temperature_c,
        },
        "model": _model_content(result),
        "remedy": _remedy_content(result),
        "design": design_content(fit.design),
        "parameters": _parameters_content(result),
        "fitted_to": "all usable observations",
        "correlation": {"names": list(fit.solution.names), "matrix": _plain(fit.correlation[np.ix_(free, free)])},
        "covariance": {"names": list(fit.solution.names), "matrix": _plain(fit.covariance[np.ix_(free, free)])},
        "rank": fit.rank,
        "n_free": fit.n_free,
        "unobservable": [
            {
                "text": one.text,
                "names": list(one.names),
                "coefficients": _plain(np.asarray(one.coefficients)),
                "held_by_prior": bool(one.held_by_prior),
            }
            for one in fit.unobservable
        ],
        "converged": fit.converged,
        "message": fit.message,
        "starts_tried": fit.basins,
        "sigma_factor": {kind: _plain(value) for kind, value in fit.sigma_factors.items()},
        "sigma0": {kind: _plain(value) for kind, value in fit.sigma0.items()},
        "observations": counts_of(result),
        "split": result.split,
        "splits": {name: _split_content(held) for name, held in result.held.items()},
        "splits_not_made": dict(result.not_split),
        "sky": _sky_content(result),
        "fit_to_all": _angles_of(fit),
        "sun_check_median_mrad": _plain(1e3 * result.seen.sun_check_rad),
        "targets": {
            name: {
                "center_m": _plain(one.center_m),
                "right": _plain(one.right),
                "up": _plain(one.up),
                "width_m": one.width_m,
                "height_m": one.height_m,
                "flatness_mm": 1e3 * one.flatness_m,
            }
            for name, one in plant.targets.items()
        },
        "diagnosis": result.diagnosis.content(),
        "doubts": [doubt_content(one) for one in result.doubts],
        "notes": [doubt_content(one) for one in result.notes],
        "paint_properties": _properties(result),
    }


def _remedy_content(result: HeliostatResult) -> dict[str, Any] | None:
    """Say which model this is of a heliostat whose fault was undone; None where nothing was."""
    if result.as_stated is None:
        return None
    (fault, *_) = result.diagnosis.faults
    applied = result.free != AS_STATED
    return {
        "kind": fault.kind,
        "applied": applied,
        "text": f"{fault.text} {fault.remedy}",
        "other_model": AS_STATED_FILE if applied else HELIOSTAT_FILE,
    }


def _sky_content(result: HeliostatResult) -> dict[str, Any] | None:
    if result.sky is None:
        return None
    return {
        "target": result.sky.target,
        "azimuth_deg": list(result.sky.azimuths_deg),
        "elevation_deg": list(result.sky.elevations_deg),
        "sigma_beam_mrad": _plain(1e3 * result.sky.sigma_beam_rad),
        "extrapolated": result.sky.extrapolated.tolist(),
    }


def _properties(result: HeliostatResult) -> dict[str, Any] | None:
    import json

    return json.loads(result.properties) if result.properties else None


def _model_content(result: HeliostatResult) -> dict[str, Any]:
    design = result.fit.design
    choice = result.choice
    content: dict[str, Any] = {
        "name": result.free,
        "free": list(result.fit.solution.names),
        "kind": _preset_of(design),
        "chosen_because": _reason(result),
    }
    if choice is not None:
        content["candidates"] = [
            {
                "name": one.name,
                "n_free": one.n_free,
                "blocked_rms_mrad": _plain(1e3 * one.blocked_rms_rad),
                "fit_rms_mrad": _plain(1e3 * one.fit_rms_rad),
                "aicc": _plain(one.aicc),
            }
            for one in choice.table
        ]
    return content


def _reason(result: HeliostatResult) -> str:
    if result.choice is not None:
        return result.choice.reason
    return (
        "what the other heliostats of the field have in common is usual"
        if result.free == FIELD
        else "not chosen by trial"
    )


def _preset_of(design: HeliostatDesign) -> str:
    from calibration.heliostat.kinematic_model.design import LinearActuator

    if isinstance(design.drives[0], LinearActuator):
        return "linear-actuators"
    names = design.parameters.names
    if "initial_angle_1" in names:
        return "ideal-actuators"
    return "six-error" if "canting" in names else "drone" if "pylon_length" in names else "azimuth-elevation"


def _parameters_content(result: HeliostatResult) -> dict[str, Any]:
    fit, content = result.fit, {}
    trained = None if result.main is None else result.main.fit.design.parameters
    for index, name in enumerate(fit.names):
        prior = float(fit.design.parameters.sigmas[index])
        state = "held" if prior == 0 else "free" if np.isinf(prior) else "prior"
        content[name] = {
            "value": float(fit.values[index]),
            "sigma": _plain(fit.sigma[index]),
            "unit": fit.design.parameters.units[index],
            "state": state,
            "nominal": float(fit.nominal.parameters.values[index]),
            "prior_sigma": prior if state == "prior" else None,
            "value_of_train_rows": trained.value(name) if trained is not None and name in trained.names else None,
        }
    return content


def counts_of(result: HeliostatResult) -> dict[str, Any]:
    """Return how many rows there are, how many were used, and how many were left out for each reason."""
    flags = final_flags(result)[0]
    named = {flag: flags.count(flag) for flag in dict.fromkeys(flags) if flag}
    return {"n": len(flags), "used": flags.count(""), "left_out": named}


def left_out_text(counts: Mapping[str, Any]) -> str:
    """Return which rows were left out, by reason, in words; empty where none was.

    counts: As ``heliostat.json`` has them.

    >>> left_out_text({"n": 87, "used": 73, "left_out": {"outlier": 11, "sun": 3}})
    '14 left out: 11 outlier, 3 sun'
    """
    named = ", ".join(f"{count} {flag}" for flag, count in counts["left_out"].items())
    return f"{counts['n'] - counts['used']} left out: {named}" if named else ""


def _angles_of(fit: HeliostatFit) -> dict[str, Any]:
    beam, normal = fit.residuals.beam_angle_rad[fit.used], fit.residuals.normal_angle_rad[fit.used]
    return {"n": int(np.count_nonzero(fit.used)), **_statistics("beam", beam), **_statistics("normal", normal)}


def _statistics(name: str, angles_rad: FloatArray) -> dict[str, Any]:
    known = 1e3 * angles_rad[np.isfinite(angles_rad)]
    if not known.size:
        return {f"{name}_{what}_mrad": None for what in ("rms", "median", "max")}
    values = {"rms": np.sqrt(np.mean(known**2)), "median": np.median(known), "max": known.max()}
    return {f"{name}_{what}_mrad": float(value) for what, value in values.items()}


def angles_content(summary: AngleSummary) -> dict[str, Any]:
    """Return a summary of angles with its units in the names [mrad].

    summary: Of the beam and of the normal.
    """
    content: dict[str, Any] = {"n": summary.n}
    for kind in ("beam", "normal"):
        for what in ("rms", "median", "max"):
            content[f"{kind}_{what}_mrad"] = _plain(1e3 * getattr(summary, f"{kind}_{what}_rad"))
    return content


def _split_content(held: HeldOut) -> dict[str, Any]:
    prediction = held.prediction
    # What must be known before the numbers are read stands before them.
    return {
        "doubts": [doubt_content(one) for one in held.doubts],
        "note": held.split.note,
        "extrapolated_count": int(np.count_nonzero(prediction.extrapolated)),
        "predicted_sigma_median_mrad": _plain(1e3 * _median(prediction.sigma_beam_rad)),
        "model": list(held.fit.solution.names),
        "train": angles_content(held.train),
        "test": angles_content(held.test),
    }


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _plain(value: npt.ArrayLike) -> Any:
    """Return numbers as JSON has them: lists, and None for what is not finite."""
    array = np.asarray(value, dtype=np.float64)
    if np.isfinite(array).all():
        return array.tolist()
    plain = array.astype(object)
    plain[~np.isfinite(array)] = None
    return plain.tolist()


# --- summaries --------------------------------------------------------------------------------------------------------


def headline(result: HeliostatResult) -> dict[str, float | int | None]:
    """Return the headline numbers of a heliostat, in the order of their importance.

    Returns: Numbers with their units in the names; None where not determined.
    """
    main, counts = result.main, counts_of(result)
    whole = _angles_of(result.fit)
    others = {
        f"beam_{name.replace('-', '_')}_test_rms_mrad": _plain(1e3 * held.test.beam_rms_rad)
        for name, held in result.held.items()
        if name != result.split
    }
    test = {} if main is None else angles_content(main.test)
    train = {} if main is None else angles_content(main.train)
    return {
        "beam_test_rms_mrad": test.get("beam_rms_mrad"),
        "beam_train_rms_mrad": train.get("beam_rms_mrad"),
        "beam_test_median_mrad": test.get("beam_median_mrad"),
        "normal_test_rms_mrad": test.get("normal_rms_mrad"),
        "normal_train_rms_mrad": train.get("normal_rms_mrad"),
        "beam_all_rows_rms_mrad": whole["beam_rms_mrad"],
        "normal_all_rows_rms_mrad": whole["normal_rms_mrad"],
        "predicted_sigma_beam_mrad": None if main is None else _split_content(main)["predicted_sigma_median_mrad"],
        "extrapolated_count": 0 if main is None else int(np.count_nonzero(main.prediction.extrapolated)),
        **others,
        "observations_count": counts["n"],
        "used_count": counts["used"],
        "outlier_count": counts["left_out"].get("outlier", 0),
        "left_out_count": counts["n"] - counts["used"],
        "free_parameters_count": result.fit.n_free,
        "rank_count": result.fit.rank,
        "sun_check_median_mrad": _plain(1e3 * result.seen.sun_check_rad),
    }


def heliostat_summary(
    result: HeliostatResult, *, durations_s: Mapping[str, float], input_sha256: Mapping[str, str]
) -> Summary:
    """Return the summary of one heliostat.

    durations_s: Time of each stage [s].
    input_sha256: Hashes of what was read; that of the observations alone is added.
    Returns: Headline numbers, the splits, doubts.
    """
    numbers = headline(result)
    why = result.not_split.get(result.split, "the observations give none")
    texts = {"heliostat": result.name, "model": result.free, "split": result.split}
    if left_out := left_out_text(counts_of(result)):
        texts["left_out"] = left_out
    if result.notes:
        texts["notes"] = "; ".join(one.text for one in result.notes)
    return Summary(
        kind=KIND,
        name=result.name,
        numbers=numbers,
        texts=texts,
        doubts=result.doubts,
        durations_s=dict(durations_s),
        input_sha256={**input_sha256, "observations": result.observations_sha256},
        not_determined={key: why for key, value in numbers.items() if value is None},
    )


def read_heliostat(folder: Path) -> dict[str, Any]:
    """Read ``heliostat.json`` of a folder of results."""
    return read_json(folder / HELIOSTAT_FILE)


def read_results(folder: Path) -> Iterator[dict[str, Any]]:
    """Read ``heliostat.json`` of each calibrated heliostat in a folder of results.

    InputError: No results there, or results of another version.
    """
    files = (
        [folder / HELIOSTAT_FILE] if (folder / HELIOSTAT_FILE).is_file() else sorted(folder.glob(f"*/{HELIOSTAT_FILE}"))
    )
    if not files:
        raise InputError(f"{folder}: no {HELIOSTAT_FILE} here or one folder below; give the results of a calibration")
    for file in files:
        content = read_heliostat(file.parent)
        missing = [key for key in ("design", "parameters", "targets", "site") if key not in content]
        if missing:
            raise InputError(f"{file}: {', '.join(missing)} are missing; calibrate again with this version")
        yield content


def stored_site(content: Mapping[str, Any]) -> Site:
    """Return the site from the content of ``heliostat.json``."""
    return Site(**{"temperature_c": 12.0, **content["site"]})
