"""The plan of any source: what it will be worth, what limits it, and what each alternative brings."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.planning.pipeline.alternatives import WORTH_A_WORD, try_changes, words_of_best, write_alternatives
from deflectometry.planning.prospect import LIMITED, Alternative, PlannedSource, Prospect, words_of_limits
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, hash_files, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress

#: Files of a plan.
LIMITS_FILE, FACETS_FILE = "limits.csv", "facets.csv"
MAP_FILE = "expected_slope_map.nc"


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult(InstrumentResult):
    """What a measurement will be worth, and what would better it.

    prospect: As planned.
    limits: Share of each source in each variance.
    alternatives: What was changed, that of the largest gain first; impossible ones last.
    """

    kind: ClassVar[str] = "deflectometry-plan"
    prospect: Prospect
    limits: Mapping[str, Mapping[str, float]]
    alternatives: tuple[Alternative, ...]

    def summarise(self) -> Summary:
        """Collect the sigmas, the share that is seen, and what limits."""
        prospect = self.prospect
        numbers: dict[str, float | int | None] = {
            "seen_share": prospect.seen_share,
            "sample_spacing_m": prospect.spacing_m,
            "samples_count": prospect.samples,
        }
        numbers |= {sigma_key(name): _or_none(one) for name, one in prospect.sigmas().items()}
        kept = (
            "focal_length_x_m",
            "sigma_focal_length_x_m",
            "focal_length_y_m",
            "sigma_focal_length_y_m",
            "sigma_random_x_rms_rad",
            "sigma_random_y_rms_rad",
            "sigma_mean_normal_x_rad",
            "sigma_mean_normal_y_rad",
            "sigma_distance_from_image_m",
        )
        numbers |= {key: prospect.numbers[key] for key in kept if key in prospect.numbers}
        texts = {
            "limits": words_of_limits(self.limits),
            "best": self._best(),
            "resolution": f"samples {1e3 * prospect.spacing_m:.3g} mm apart on the mirror: waves shorter than "
            f"{2e3 * prospect.spacing_m:.3g} mm are not seen",
            "sigma": "1 standard deviation of what the measurement will say, by its own estimator on predicted samples "
            "of a mirror of design shape",
            **prospect.texts,
        }
        flat = {key: "a flat design has none" for key in numbers if numbers[key] is None and "focal_length" in key}
        reasons = flat | {key: "no facet is measured" for key in numbers if numbers[key] is None and key not in flat}
        each: dict[str, dict[str, float | int | None]] = {}
        for one in prospect.facets if len(prospect.facets) > 1 else ():
            x, y = one.sigma_canting_rad.tolist()
            each[one.name] = {
                "seen_share": one.seen_share,
                "sigma_canting_x_rad": _or_none(x),
                "sigma_canting_y_rad": _or_none(y),
            }
        unknown = [key for own in each.values() for key, value in own.items() if value is None]
        reasons |= dict.fromkeys(unknown, f"the facet will not be measured; {FACETS_FILE} says why")
        return self._summary(numbers, texts, reasons, facets=each)

    def _best(self) -> str:
        return words_of_best(self.alternatives, LIMITED, self._costs)

    def _costs(self, one: Alternative) -> list[str]:
        """Say what an alternative costs beside sigmas."""
        said, prospect = [], self.prospect
        if one.beside["sample_spacing_m"] > WORTH_A_WORD * prospect.spacing_m:
            said.append(f"samples {1e3 * one.beside['sample_spacing_m']:.3g} mm apart")
        if one.beside["seen_share"] < prospect.seen_share / WORTH_A_WORD:
            said.append(f"only {one.beside['seen_share']:.0%} of the mirror sees the pattern")
        return said

    def write_files(self, folder: Path) -> None:
        """Write the expected map and the tables into an existing folder."""
        prospect = self.prospect
        write_slope_map(folder / MAP_FILE, {"": prospect.slope_map}, {"name": self.name})
        for name, columns in prospect.tables.items():
            write_table_csv(folder / name, columns)
        write_alternatives(folder, prospect, self.alternatives, sigma_key)
        names = list(prospect.sigmas())
        sources = list(dict.fromkeys(source for shares in self.limits.values() for source in shares))
        shares = {name: [self.limits[name].get(source, 0.0) for source in sources] for name in names}
        write_table_csv(
            folder / LIMITS_FILE, {"source": sources} | {f"share_of_{name}": one for name, one in shares.items()}
        )
        canting = np.array([one.sigma_canting_rad for one in prospect.facets])
        if len(prospect.facets) == 1:
            canting = np.full((1, 2), np.nan)
        write_table_csv(
            folder / FACETS_FILE,
            {
                "facet": [one.name for one in prospect.facets],
                "seen_share": [one.seen_share for one in prospect.facets],
                "sigma_canting_x_rad": canting[:, 0].tolist(),
                "sigma_canting_y_rad": canting[:, 1].tolist(),
                "hole": [one.hole for one in prospect.facets],
            },
        )

    def headline(self) -> str:
        """Return the sigmas, what limits them and the best alternatives in a few lines for the terminal."""
        sigmas = self.prospect.sigmas()
        slopes = ", ".join(f"{1e3 * sigmas[f'slope_{axis}']:.4f} mrad in {axis}" for axis in "xy")
        lines = [f"{self.name}: expected from {self.prospect.samples} samples", f"  slopes           sigma {slopes}"]
        for name, words in (("canting", "canting"), ("mean_normal", "mean normal")):
            if name in sigmas:
                lines.append(f"  {words:<16} sigma {1e3 * sigmas[name]:.4f} mrad RMS")
        for axis in "xy":
            length = self.prospect.numbers.get(f"focal_length_{axis}_m")
            if length is not None:
                sigma = self.prospect.numbers[f"sigma_focal_length_{axis}_m"]
                lines.append(f"  focal length {axis}   {number_text(float(length), sigma, 'm')}")
        lines += [
            f"  sees the pattern {100 * self.prospect.seen_share:.1f} % of the mirror, samples "
            f"{1e3 * self.prospect.spacing_m:.3g} mm apart",
            *(f"  {name:<16} {self.prospect.texts[name]}" for name in ("target",) if name in self.prospect.texts),
            f"  limited by       {words_of_limits(self.limits, 1)}",
            f"  better           {self._best()}",
        ]
        return "\n".join(lines)


def sigma_key(name: str) -> str:
    """Return the key of a sigma, with its unit."""
    if name.startswith("curvature"):
        return f"sigma_{name}_per_m"
    return f"sigma_{name}_rms_rad"


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def run_plan(
    planned: PlannedSource, folder: Path, files: tuple[Path, ...], progress: Progress | None = None
) -> PlanResult:
    """Say what a measurement will be worth, and look at what might be done otherwise.

    folder, files: Where measurement.toml is, and all that was read.
    InputError: A set-up that shows the mirror no pattern.
    EstimationError: One that determines no slopes.
    """
    progress = progress or SilentProgress()
    with progress.stage("as planned"):
        prospect = planned.prospect()
    with progress.stage("what limits"):
        limits = planned.limits(prospect)
    changes = [one for one in planned.changes() if one.is_worth_a_look(limits)]
    alternatives = try_changes(changes, prospect, progress)
    return PlanResult(
        name=planned.name,
        prospect=prospect,
        limits=limits,
        alternatives=alternatives,
        doubts=prospect.doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(files, folder),
    )
