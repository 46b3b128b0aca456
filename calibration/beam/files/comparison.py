"""Beams against the mirror that made them: comparison.csv, canting.csv, expected.nc, summary."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from calibration.beam.mirror.facets import Mirror
from calibration.beam.mirror.flux_fit import FluxFit, FluxPhoto, MirrorStand
from heliogauge.results.arrays import LabelledArray, write_arrays
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.sunlight.sun_shapes import SOLAR_DISC_RAD
from heliogauge.validate import FloatArray

__all__ = ["CANTING_FILE", "COMPARISON_FILE", "EXPECTED_FILE", "Comparison", "PhotoComparison"]

COMPARISON_FILE, CANTING_FILE, EXPECTED_FILE = "comparison.csv", "canting.csv", "expected.nc"


@dataclass(frozen=True, slots=True)
class PhotoComparison:
    """One photo against the expected flux.

    correlation, correlation_fitted: With the mirror as it is, and with what was fitted; NaN without a fit.
    d90_m, d90_expected_m, d90_fitted_m: Circle with 90 % of the light on the target, measured and expected [m].
    center_off_m: Centre of the measured light to that of the expected one, both aimed alike [m].
    """

    correlation: float
    correlation_fitted: float
    d90_m: float
    d90_expected_m: float
    d90_fitted_m: float
    center_off_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(InstrumentResult):
    """Measured and expected flux of a mirror.

    mirror: The mirror as it was given.
    stand: Where it stands.
    sun: Sun shape in words.
    photos: Measured flux.
    rows: Each photo against the expected flux.
    before: With the mirror as it is.
    after: With canting, focus and scatter fitted; None: not fitted.
    left_out: Photos that were not compared, each with the reason.
    """

    kind: ClassVar[str] = "beam-mirror"
    mirror: Mirror
    stand: MirrorStand
    sun: str
    photos: tuple[FluxPhoto, ...]
    rows: tuple[PhotoComparison, ...]
    before: FluxFit
    after: FluxFit | None
    left_out: Mapping[str, str] = field(default_factory=dict)

    def why_canting_is_open(self) -> str:
        """Say why the photos do not determine the canting; empty where they do, or where nothing was fitted."""
        after = self.after
        if after is None or after.is_canting_told:
            return ""
        if after.may_be_exchanged:
            odds = np.exp(min(after.rival_log_odds, 50.0))
            return f"with facets exchanged the photos fit nearly as well (odds {odds:.2g} to 1)"
        wide_m = float(np.median([np.ptp(one.points_m[:, :2], axis=0).max() for one in self.mirror.facets]))
        away_m = float(np.linalg.norm(self.photos[0].target.center_m - self.stand.position_m))
        sun_m = 2 * SOLAR_DISC_RAD * away_m
        where = "the only photo" if len(self.photos) == 1 else f"all {len(self.photos)} photos"
        return (
            f"{after.sigma_words()}, for the facets ({wide_m:.2f} m wide, the sun's disc {sun_m:.2f} m on the target) "
            f"throw their light onto the same place in {where}"
        )

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        rows, after = self.rows, self.after
        relative = np.array([one.d90_expected_m / one.d90_m - 1 for one in rows])
        known = np.abs(relative[np.isfinite(relative)])
        reasons = {}
        numbers: dict[str, float | int | None] = {
            "photos_count": len(rows),
            "facets_count": len(self.mirror.facets),
            "least_correlation_ratio": float(min(one.correlation for one in rows)),
            "median_correlation_ratio": float(np.median([one.correlation for one in rows])),
            "largest_d90_difference_share": float(known.max()) if known.size else None,
            "largest_center_off_m": float(max(one.center_off_m for one in rows)),
        }
        if not known.size:
            reasons["largest_d90_difference_share"] = "in every photo the beam's middle is at the end of the grey scale"
        if after is not None:
            numbers["least_correlation_fitted_ratio"] = float(min(one.correlation_fitted for one in rows))
            told = after.is_canting_told
            numbers["largest_canting_rad"] = float(np.hypot(*after.canting_rad.T).max()) if told else None
            if not told:
                reasons["largest_canting_rad"] = self.why_canting_is_open()
            numbers["sigma_largest_canting_rad"] = float(after.sigma_canting_rad.max())
            numbers["curvature_per_m"] = after.curvature_1pm
            numbers["sigma_curvature_per_m"] = after.sigma_curvature_1pm
            numbers["scatter_rad"], numbers["sigma_scatter_rad"] = after.scatter_rad, after.sigma_scatter_rad
            numbers["slope_error_bound_rad"] = after.slope_error_bound_rad
        texts = {
            "mirror": self.mirror.source,
            "mount": f"{self.stand.mount}, at {', '.join(f'{value:.3f}' for value in self.stand.position_m)} m",
            "sun": self.sun,
            "correlation": "of measured and expected flux over the target, aim and brightness fitted to each photo",
            "canting": "turn of each facet's normal beyond the given surface; the mean of all facets is zero, "
            "because it is "
            "the pointing",
            "scatter": "of the reflected beam in one direction, beyond surface and sun: slope errors finer than the "
            "given surface, "
            "dirt, haze, blur of the photo; the bound takes all of it for slope errors (95 %)",
            "sigma": "1 standard deviation, from residuals in blocks as wide as the sun's disc on the target",
        }
        return self._summary(numbers, texts, reasons)

    def write_files(self, folder: Path) -> None:
        """Write comparison.csv, canting.csv and expected.nc into an existing folder."""
        after = self.after
        nowhere = np.full((len(self.photos), 2), np.nan)
        columns: dict[str, Sequence[object] | FloatArray] = {
            "image": [one.name for one in self.photos],
            "target": [one.target.name for one in self.photos],
            "x_m": np.array([one.aim_m[0] for one in self.photos]),
            "y_m": np.array([one.aim_m[1] for one in self.photos]),
        }
        for name in ("correlation", "correlation_fitted", "d90_m", "d90_expected_m", "d90_fitted_m", "center_off_m"):
            columns[name] = np.array([getattr(one, name) for one in self.rows])
        aims = nowhere if after is None else after.aims_m
        sigma = nowhere if after is None else after.sigma_aims_m
        for number, axis in enumerate("xy"):
            columns[f"aim_{axis}_m"], columns[f"sigma_aim_{axis}_m"] = aims[:, number], sigma[:, number]
        write_table_csv(folder / COMPARISON_FILE, columns)
        if after is not None:
            centers = np.array([one.center_m for one in self.mirror.facets])
            canting: dict[str, Sequence[object] | FloatArray] = {
                "facet": list(self.mirror.names),
                **{f"{axis}_m": centers[:, number] for number, axis in enumerate("xyz")},
                "canting_x_mrad": 1e3 * after.canting_rad[:, 0],
                "canting_y_mrad": 1e3 * after.canting_rad[:, 1],
                "sigma_canting_x_mrad": 1e3 * after.sigma_canting_rad[:, 0],
                "sigma_canting_y_mrad": 1e3 * after.sigma_canting_rad[:, 1],
                "determined": [int(after.is_canting_told)] * len(centers),
            }
            write_table_csv(folder / CANTING_FILE, canting)
        if self.left_out:
            write_table_csv(
                folder / "left_out.csv", {"photo": list(self.left_out), "reason": list(self.left_out.values())}
            )
        self._write_flux(folder / EXPECTED_FILE)

    def _write_flux(self, path: Path) -> None:
        arrays: list[LabelledArray] = []
        attributes = {"title": f"Measured and expected flux: {self.name}"}
        for number, photo in enumerate(self.photos):
            end = f"_{number + 1}"
            axes = (f"y{end}", f"x{end}")
            arrays += [
                LabelledArray(axes[0], axes[:1], photo.grid.y_m, "m", "up on the target"),
                LabelledArray(axes[1], axes[1:], photo.grid.x_m, "m", "right on the target"),
            ]
            layers: list[tuple[str, FloatArray]] = [
                ("measured", photo.flux_dn),
                ("expected", self.before.expected_dn[number]),
            ]
            if self.after is not None:
                layers.append(("fitted", self.after.expected_dn[number]))
            for name, values in layers:
                arrays.append(LabelledArray(f"{name}{end}", axes, values.astype(np.float32), "DN", f"{name} flux"))
            attributes[f"photo{end}"] = photo.name
        write_arrays(path, arrays, attributes)

    def headline(self) -> str:
        """Return correlation, D90 and canting."""
        numbers = self.summarise().numbers
        d90 = numbers["largest_d90_difference_share"]
        lines = [
            f"{self.name}: {len(self.rows)} photos against {self.mirror.source}",
            f"  correlation {numbers['least_correlation_ratio']:.4f} or better, D90 "
            f"{'not determined' if d90 is None else f'within {d90:.1%}'}, centres within "
            f"{numbers['largest_center_off_m']:.3f} m",
        ]
        after = self.after
        if after is not None:
            sigma_mrad = 1e3 * float(after.sigma_canting_rad.max())
            canting = f"not determined ({after.sigma_words()})"
            if after.is_canting_told:
                canting = f"up to {1e3 * float(np.hypot(*after.canting_rad.T).max()):.2f} \u00b1 {sigma_mrad:.2f} mrad"
            lines.append(
                f"  fitted: correlation {numbers['least_correlation_fitted_ratio']:.4f}; canting {canting}; slope "
                f"error below {1e3 * after.slope_error_bound_rad:.2f} mrad (95 %)"
            )
        return "\n".join(lines)
