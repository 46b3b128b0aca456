"""Where the second map stands in the frame of the first, and whether both are of one mirror."""

from dataclasses import dataclass, replace

import numpy as np

from deflectometry.comparison.in_plane import (
    BLOCKS,
    SAME_CORRELATION,
    FoundMotion,
    Likeness,
    find_motion,
    likeness,
    quarter_turns,
)
from deflectometry.comparison.judgement import SIGNIFICANCE
from deflectometry.comparison.moved_map import PlaneMotion
from heliogauge.adjust.f_distribution import f_tail
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError
from heliogauge.slopes.map import SlopeMap


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """How the second map was placed in the frame of the first.

    motion: From the second's frame to the first's.
    found: The motion that the fine structure gives, with its sigma; None where it gives none.
    likeness: Of the fine structures as placed.
    is_moved: Whether the second map was moved.
    """

    motion: PlaneMotion
    found: FoundMotion | None
    likeness: Likeness
    is_moved: bool


def place_maps(map_a: SlopeMap, map_b: SlopeMap, *, both: bool, as_placed: bool) -> tuple[Placed, tuple[Doubt, ...]]:
    """Find where the second map stands in the frame of the first."""
    unknown = Likeness(float("nan"), float("nan"), float("nan"))
    if not both:
        note = Doubt(
            "one_slope_compared",
            "one of the maps has slopes in x only: both frames are taken as they are",
            severity=Severity.NOTE,
        )
        return Placed(PlaneMotion.none(), None, unknown, is_moved=False), (note,)
    start, here, doubts = PlaneMotion.none(), unknown, []
    try:
        here = likeness(map_a, map_b, start)
    except EstimationError:
        # Frames with origins far apart.
        here = unknown
    if not as_placed and not here.correlation > SAME_CORRELATION:
        candidates = [(one, _likeness_or_none(map_a, map_b, one)) for one in quarter_turns(map_a, map_b)]
        known = [(one, like) for one, like in candidates if like is not None and like.correlation > SAME_CORRELATION]
        if known:
            start, here = max(known, key=lambda one: one[1].correlation)
    if np.isfinite(here.correlation) and not here.correlation > SAME_CORRELATION:
        doubts.append(_unlike(map_a, map_b, here))
    if not here.correlation > SAME_CORRELATION:
        if not doubts:
            doubts.append(
                Doubt(
                    "frames_not_compared",
                    "the fine structure of the slopes is below its noise: both frames are taken as they are, and "
                    "whether the maps are of one mirror is not checked",
                    severity=Severity.NOTE,
                )
            )
        return Placed(start, None, here, is_moved=start.turn_rad != 0), tuple(doubts)
    try:
        found = find_motion(map_a, map_b, start)
    except EstimationError:
        found = None
    if found is None or as_placed:
        return Placed(start, found, here, is_moved=start.turn_rad != 0), tuple(doubts)
    step = np.array([found.motion.turn_rad - start.turn_rad, *(found.motion.shift_m - start.shift_m)])
    # The covariance is itself known from some blocks only: Hotelling's T square (Annals of Mathematical Statistics 2
    # (1931) 360).
    square, freedom = float(step @ np.linalg.solve(found.covariance, step)), BLOCKS**2 - 1
    moves = f_tail(square * (freedom - 2) / (3 * freedom), 3, freedom - 2) < SIGNIFICANCE
    if not moves and start.turn_rad == 0 and not start.shift_m.any():
        return Placed(start, found, here, is_moved=False), tuple(doubts)
    placed = Placed(found.motion, found, found.likeness, is_moved=True)
    doubts.append(
        Doubt(
            "frames_differ",
            f"the frames of the two maps differ by {np.degrees(found.motion.turn_rad):.3f} deg, "
            f"{1e3 * found.motion.shift_m[0]:.1f} mm in x and {1e3 * found.motion.shift_m[1]:.1f} mm in y, by the fine "
            "structure of their slopes: the second was moved by that (--as-placed leaves it)",
            {
                "turn_rad": found.motion.turn_rad,
                "shift_x_m": float(found.motion.shift_m[0]),
                "shift_y_m": float(found.motion.shift_m[1]),
            },
            Severity.NOTE,
        )
    )
    return placed, tuple(doubts)


def _likeness_or_none(map_a: SlopeMap, map_b: SlopeMap, motion: PlaneMotion) -> Likeness | None:
    try:
        return likeness(map_a, map_b, motion)
    except EstimationError:
        return None


def _unlike(map_a: SlopeMap, map_b: SlopeMap, here: Likeness) -> Doubt:
    """Say that the fine structures have nothing in common, or only when one map is mirrored."""
    mirrored = replace(
        map_b,
        x_m=-map_b.x_m[::-1],
        **{
            name: getattr(map_b, name)[:, ::-1] * (-1 if name in ("slope_x", "design_slope_x") else 1)
            for name in ("slope_x", "slope_y", "design_slope_x", "design_slope_y", "sigma_random_x", "sigma_random_y")
        },
        flags=map_b.flags[:, ::-1],
        aperture=map_b.aperture[:, ::-1],
        height_m=map_b.height_m[:, ::-1],
    )
    found = [_likeness_or_none(map_a, mirrored, one) for one in quarter_turns(map_a, mirrored)]
    best = max((one.correlation for one in found if one is not None and np.isfinite(one.correlation)), default=0.0)
    if best > SAME_CORRELATION:
        return Doubt(
            "map_is_mirrored",
            f"the fine structures agree (correlation {best:.2f}) only where one of the maps is mirrored: one was seen "
            "from behind, or one of its axes has the other sign; put that right and compare again",
            {"correlation_ratio": best},
            Severity.SERIOUS,
        )
    return Doubt(
        "different_mirrors",
        f"the fine structures of the slopes have nothing in common (correlation {here.correlation:.2f}, 1 for one "
        f"mirror), though each is above its noise ({1e3 * here.structure_a_rad:.3g} and "
        f"{1e3 * here.structure_b_rad:.3g} mrad RMS): are these results of one mirror?",
        {"correlation_ratio": here.correlation},
        Severity.SERIOUS,
    )
