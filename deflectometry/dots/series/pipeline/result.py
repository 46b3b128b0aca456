"""What a series of photos of dots gave: a row for each frame, and the first frame's own result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deflectometry.dots.series.first_shape import FirstShape
from deflectometry.dots.series.frame_slopes import FacetMotion, FrameSlopes
from deflectometry.pipeline.result import Result
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

SERIES_FILE, FACETS_FILE = "series.csv", "facet_tilts.csv"


@dataclass(frozen=True, slots=True, eq=False)
class FacetRow(ShortRepr):
    """One facet in one frame.

    tilt_rad, sigma_tilt_rad (2,): Slope of its mean normal against the first frame, in the mirror's frame there [rad].
    rms_rad, sigma_rms_rad (2,): RMS of the angles from the design in x and y; the sigma is that of its change against
        the first frame [rad].
    count: Dots.
    flag: Why it is not measured; empty where it is.
    """

    tilt_rad: FloatArray
    sigma_tilt_rad: FloatArray
    rms_rad: FloatArray
    sigma_rms_rad: FloatArray
    count: int
    flag: str = ""

    @classmethod
    def missing(cls, flag: str) -> "FacetRow":
        """Return that of a facet that was not measured."""
        nothing = np.full(2, np.nan)
        return cls(nothing, nothing, nothing, nothing, 0, flag)


@dataclass(frozen=True, slots=True, eq=False)
class FrameRow(ShortRepr):
    """One frame of a series.

    frame: Its name.
    time_s: When it was taken [s].
    normal_rad (2,): Angles of the mirror's mean normal in the screen's frame, as mean_normal of the first frame [rad].
    turn_rad, sigma_turn_rad (2,): Slope of the mean normal against the first frame, in the mirror's frame there, mean
        of all facets by their dots [rad].
    rms_rad, sigma_rms_rad (2,): RMS of the angles from the design in x and y; the sigma is that of its change against
        the first frame [rad].
    count: Dots.
    probability: Of the place in the pattern.
    flag: Why it is not measured, or open; empty where all is well.
    facets: Each facet.
    """

    frame: str
    time_s: float
    normal_rad: FloatArray
    turn_rad: FloatArray
    sigma_turn_rad: FloatArray
    rms_rad: FloatArray
    sigma_rms_rad: FloatArray
    count: int
    probability: float
    flag: str
    facets: Mapping[str, FacetRow]

    @classmethod
    def missing(cls, frame: str, time_s: float, flag: str, facets: Sequence[str]) -> "FrameRow":
        """Return the row of a frame that was not measured."""
        nothing = np.full(2, np.nan)
        rows = dict.fromkeys(facets, FacetRow.missing(flag or "not measured: too few dots here or in the first frame"))
        return cls(frame, time_s, nothing, nothing, nothing, nothing, nothing, 0, float("nan"), flag, rows)

    def measured(self, one: FrameSlopes, start: FrameSlopes, shapes: Mapping[str, FirstShape]) -> "FrameRow":
        """Return the row with what was measured.

        start: The first frame.
        shapes: Its facets.
        EstimationError: None of them is seen, or too little of each.
        """
        mirror_from_cam = start.pose.inverse()
        facets, failed = dict[str, FacetRow](), dict[str, FacetRow]()
        for name in [name for name in one.facets if name in shapes]:
            try:
                facets[name] = _facet_row(one.facets[name], shapes[name], mirror_from_cam, one)
            except EstimationError as error:
                failed[name] = FacetRow.missing(f"not measured: {error}")
        if not facets:
            reasons = "; ".join(row.flag.removeprefix("not measured: ") for row in failed.values())
            raise EstimationError(reasons or "no facet of the first frame shows the pattern")
        seen = facets.values()
        share = np.array([row.count for row in seen], dtype=np.float64)
        share /= share.sum()
        turn = share @ np.array([row.tilt_rad for row in seen])
        sigma = np.linalg.norm(share[:, None] * [row.sigma_tilt_rad for row in seen], axis=0)
        squares = share @ np.array([row.rms_rad**2 for row in seen])
        return replace(
            self,
            normal_rad=one.normal_rad,
            turn_rad=turn,
            sigma_turn_rad=np.hypot(sigma, _by_set_up(turn, one)),
            rms_rad=np.sqrt(squares),
            sigma_rms_rad=np.linalg.norm(share[:, None] * [row.sigma_rms_rad for row in seen], axis=0),
            count=sum(row.count for row in seen),
            probability=one.probability,
            facets={
                **self.facets,
                **failed,
                **{
                    name: replace(row, sigma_tilt_rad=np.hypot(row.sigma_tilt_rad, _by_set_up(row.tilt_rad, one)))
                    for name, row in facets.items()
                },
            },
        )


def _exchanged(moved: float) -> float:
    """Return the variance of the lines of dots that an edge of the mirror shows more or less, in lines squared.

    A pattern that moves by a share m of its spacing takes a line over an edge with the probability m; the dots that
    move with it make up for m of that line. Where the lattice stands oblique to the edge its dots go over one by one,
    and the variance is less.
    """
    share = min(moved, 0.5)
    return share * (1.0 - share)


def sigma_of_rms(motion: FacetMotion, before: FacetMotion, moved: float) -> FloatArray:
    """Return the standard deviation of a change of the RMS against the first frame, (2,) [rad].

    moved: By how many dots the pattern has moved.
    """
    noise = motion.noise_rad**2 / motion.count + before.noise_rad**2 / before.count
    # A line of dots is at the edge in one of both frames; a mean of squares changes by twice the RMS times its change.
    edges = 0.5 * _exchanged(moved) * (motion.edges_rad2**2 + before.edges_rad2**2) / (4.0 * motion.mean_squares_rad2)
    return np.asarray(np.sqrt(noise + edges))


def _slope(normal: FloatArray) -> FloatArray:
    return np.asarray(-normal[:2] / normal[2])


def _by_set_up(turn_rad: FloatArray, one: FrameSlopes) -> FloatArray:
    """Return what errors of the set-up make of a turn, (2,) [rad]."""
    return np.asarray(np.linalg.norm(one.turn_shares @ turn_rad, axis=0))


def _facet_row(motion: FacetMotion, first: FirstShape, mirror_from_cam: RigidTransform, one: FrameSlopes) -> FacetRow:
    """Return the row of a facet; its sigma is that of dots and surface."""
    turn, sigma = first.turn_to(motion)
    before = first.motion.tilt_rad
    tilt = _slope(mirror_from_cam.rotate(motion.normal(before + turn)))
    tilt = tilt - _slope(mirror_from_cam.rotate(first.motion.normal(before)))
    rms = np.sqrt(motion.mean_squares_rad2)
    of_rms = sigma_of_rms(motion, first.motion, float(np.linalg.norm(tilt)) / one.step_rad)
    return FacetRow(tilt, sigma, rms, of_rms, motion.count)


@dataclass(frozen=True, slots=True, eq=False)
class SeriesResult(InstrumentResult):
    """A series of frames, ready to be written.

    Parameters
    ----------
    first : Result
        The first frame, measured as a photo of its own.
    rows : tuple of FrameRow
        Each frame, the first one included.
    name : str
        Name of the mirror.
    doubts : tuple of Doubt
        What makes the result doubtful.
    durations_s : dict of str to float
        Wall time of each stage [s].
    input_sha256 : dict of str to str
        Hash of each file read.
    """

    kind: ClassVar[str] = "deflectometry-dots-series"
    first: Result
    rows: tuple[FrameRow, ...]

    def summarise(self) -> Summary:
        """Collect how far the mirror turns, how its shape varies, and the first frame's numbers."""
        measured = [one for one in self.rows if np.isfinite(one.turn_rad).all()]
        turns = np.array([one.turn_rad for one in measured])
        rms = np.array([one.rms_rad for one in measured])
        sigma = np.array([one.sigma_turn_rad for one in measured])
        numbers: dict[str, float | int | None] = {
            "frames_count": len(self.rows),
            "measured_frames_count": len(measured),
            "flagged_frames_count": sum(bool(one.flag) for one in self.rows),
            "duration_s": self.rows[-1].time_s - self.rows[0].time_s,
        }
        for k, axis in enumerate("xy"):
            numbers |= {
                f"turn_{axis}_range_rad": float(np.ptp(turns[:, k])),
                f"turn_{axis}_rms_rad": float(np.std(turns[:, k])),
                f"sigma_turn_{axis}_rad": float(np.sqrt(np.mean(sigma[:, k] ** 2))),
                f"sd{axis}_median_rad": float(np.median(rms[:, k])),
                f"sd{axis}_range_rad": float(np.ptp(rms[:, k])),
            }
        start = self.first.summarise()
        texts = dict(start.texts) | {
            "series": "turns are slopes of the mean normal against the first frame, at the same places of the mirror; "
            "their sigmas are those of dots, surface and set-up, which scales and rotates all turns alike; those of "
            "changes of SDx and SDy are of dots and surface: errors of the set-up stand in the first frame's numbers"
        }
        return self._summary(dict(start.numbers) | numbers, texts, start.not_determined, start.facets, start.geometry_m)

    def write_files(self, folder: Path) -> None:
        """Write the rows, and the files of the first frame."""
        self.first.write_files(folder)
        write_table_csv(folder / SERIES_FILE, _series_columns(self.rows))
        write_table_csv(folder / FACETS_FILE, _facet_columns(self.rows))

    def headline(self) -> str:
        """Return how many frames were measured and how far the mirror turns."""
        numbers = self.summarise().numbers
        turns = "   ".join(
            f"{axis} {1e3 * float(numbers[f'turn_{axis}_range_rad'] or 0.0):.3f} mrad "
            f"(sigma of one {1e3 * float(numbers[f'sigma_turn_{axis}_rad'] or 0.0):.2g})"
            for axis in "xy"
        )
        medians = "   ".join(
            f"SD{axis} {1e3 * float(numbers[f'sd{axis}_median_rad'] or 0.0):.3f} mrad" for axis in "xy"
        )
        return (
            f"{self.name}: {numbers['measured_frames_count']} of {numbers['frames_count']} frames measured, "
            f"{numbers['flagged_frames_count']} flagged, {float(numbers['duration_s'] or 0.0):.3g} s\n"
            f"  range of turns   {turns}\n  median           {medians}\n  first frame:\n{self.first.headline()}"
        )


def _pairs(name: str, values: Sequence[FloatArray], unit: str = "rad") -> dict[str, Any]:
    columns = np.array(values)
    return {f"{name.format(axis)}_{unit}": columns[:, k] for k, axis in enumerate("xy")}


def _series_columns(rows: Sequence[FrameRow]) -> dict[str, Any]:
    return {
        "frame": [one.frame for one in rows],
        "time_s": [one.time_s for one in rows],
        **_pairs("mean_normal_{}", [one.normal_rad for one in rows]),
        **_pairs("turn_{}", [one.turn_rad for one in rows]),
        **_pairs("sigma_turn_{}", [one.sigma_turn_rad for one in rows]),
        **_pairs("sd{}", [one.rms_rad for one in rows]),
        **_pairs("sigma_sd{}", [one.sigma_rms_rad for one in rows]),
        "dots": [one.count for one in rows],
        "place_probability": [one.probability for one in rows],
        "flag": [one.flag for one in rows],
    }


def _facet_columns(rows: Sequence[FrameRow]) -> dict[str, Any]:
    each = [(row, name, facet) for row in rows for name, facet in row.facets.items()]
    return {
        "frame": [row.frame for row, _, _ in each],
        "time_s": [row.time_s for row, _, _ in each],
        "facet": [name for _, name, _ in each],
        **_pairs("tilt_{}", [one.tilt_rad for _, _, one in each]),
        **_pairs("sigma_tilt_{}", [one.sigma_tilt_rad for _, _, one in each]),
        **_pairs("sd{}", [one.rms_rad for _, _, one in each]),
        **_pairs("sigma_sd{}", [one.sigma_rms_rad for _, _, one in each]),
        "dots": [one.count for _, _, one in each],
        "flag": [one.flag for _, _, one in each],
    }
