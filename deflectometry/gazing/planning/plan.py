"""From measurement.toml to the spacing of the cameras: all spacings in a table, the best one named."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.gazing.planning.keys import GazingPlanMeasurement, load_gazing_plan
from deflectometry.gazing.planning.spacing import Spacing, judge_spacing, sides
from deflectometry.gazing.sun_profile import SunProfile
from heliogauge.doubts import Doubt
from heliogauge.results.folder import Summary, hash_files, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.sun_tables import read_sun
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.sunlight.sun_shapes import BuieSun

#: Table of a plan.
SPACINGS_FILE = "spacings.csv"
#: Less than this share of the mirror measured is said.
_ENOUGH = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class GazingPlanResult(InstrumentResult):
    """What each spacing of the cameras will give, and the best."""

    kind: ClassVar[str] = "backward-gazing-plan"
    spacings: tuple[Spacing, ...]
    best: Spacing

    def summarise(self) -> Summary:
        """Collect the numbers of the best spacing."""
        best = self.best
        numbers: dict[str, float | int | None] = {
            "spacing_m": best.side_m,
            "expected_error_rad": best.expected_error_rad,
            "sigma_measured_rad": best.sigma_rad,
            "sigma_at_zero_slope_rad": best.sigma_at_zero_rad,
            "measured_share": best.measured_share,
            "blind_share": best.blind_share,
        }
        texts = {
            "spacing": "side of the square of cameras with the smallest expected error of slopes; a blind point counts "
            "with the slopes that are expected",
            "not_included": "places, levels and profile of the sun, which all points share",
        }
        nothing = "no point of the mirror would be measured: every sigma is above largest_sigma_mrad"
        reasons = {
            "sigma_measured_rad": nothing,
            "sigma_at_zero_slope_rad": "near zero slope all cameras would see the same even part of the sun's disc",
        }
        return self._summary(
            numbers, texts, {key: why for key, why in reasons.items() if not np.isfinite(numbers[key] or 0.0)}
        )

    def write_files(self, folder: Path) -> None:
        """Write the table of all spacings into an existing folder."""
        names = ("side_m", "expected_error_rad", "sigma_rad", "measured_share", "blind_share", "sigma_at_zero_rad")
        write_table_csv(folder / SPACINGS_FILE, {name: [getattr(one, name) for one in self.spacings] for name in names})

    def headline(self) -> str:
        """Return the best spacing in a few lines for the terminal."""
        best = self.best

        def said(value_rad: float, words: str = "") -> str:
            return f"{1e3 * value_rad:.3f} mrad{words}" if np.isfinite(value_rad) else "not determined"

        return (
            f"{self.name}: cameras in a square of {best.side_m:.2g} m\n"
            f"  slopes           {said(best.sigma_rad, ' each way where measured')}\n"
            f"  near zero slope  {said(best.sigma_at_zero_rad)}\n"
            f"  measured share   {100 * best.measured_share:.0f} %, blind {100 * best.blind_share:.0f} %"
        )


def run_folder(folder: Path, progress: Progress | None = None) -> GazingPlanResult:
    """Read the folder of a plan, and plan as `run`."""
    return run(load_gazing_plan(folder), progress)


def run(measurement: GazingPlanMeasurement, progress: Progress | None = None) -> GazingPlanResult:
    """Compare spacings of the cameras and name the best.

    InputError: A profile that cannot be read.
    """
    progress, model = progress or SilentProgress(), measurement.model
    wanted, cameras = model.expected, model.cameras
    if model.sun.profile is not None:
        measured = read_sun(measurement.folder / model.sun.profile)
        angle = np.concatenate([[0.0], measured.angle_rad[measured.angle_rad > 0]])
        profile = SunProfile(angle, measured.radiance(angle))
    else:
        angle = np.linspace(0.0, 9e-3, 400)
        profile = SunProfile(angle, BuieSun(float(model.sun.circumsolar_ratio)).radiance(angle))
    compared = sides(cameras.closest_m, cameras.farthest_m)
    found = []
    with progress.stage("spacings", steps=len(compared)) as stage:
        for side in compared.tolist():
            found.append(
                judge_spacing(
                    side,
                    wanted.distance_m,
                    float(np.radians(wanted.incidence_deg)),
                    1e-3 * wanted.slope_error_mrad,
                    1e-2 * wanted.noise_percent,
                    1e-3 * wanted.largest_sigma_mrad,
                    profile,
                    with_middle=cameras.with_middle,
                )
            )
            stage.advance()
    best = min(found, key=lambda one: one.expected_error_rad)
    return GazingPlanResult(
        name=model.name,
        spacings=tuple(found),
        best=best,
        doubts=tuple(_doubts(best)),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


def _doubts(best: Spacing) -> Iterator[Doubt]:
    if best.measured_share < _ENOUGH:
        yield Doubt(
            "plan_measures_part",
            f"with the best spacing {100 * best.measured_share:.0f} % of the mirror is measured at once: slopes reach "
            "beyond the sun's disc; measure at several times, or with more cameras",
            {"measured_share": best.measured_share},
        )
