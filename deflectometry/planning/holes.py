"""Parts of a mirror that will not see the screen: at which of its edges, and what would bring them onto it."""

from collections.abc import Sequence
from math import ceil

import numpy as np

from deflectometry.planning.predicted_sight import FacetSight
from heliogauge.doubts import Doubt
from heliogauge.validate import FloatArray

#: What measuring says of parts that do not see the screen, by other signs: codes of its doubts.
OF_HOLES = ("mirror_sees_past_display", "given_pose_unchecked", "facets_dark", "pixels_rejected")
_EDGES = (("left", "right"), ("upper", "lower"))


def words_of_hole(sight: FacetSight) -> str:
    """Say at which edges of the screen a facet looks past it; empty where it does not."""
    inside, total = sight.inside, np.count_nonzero(sight.inside)
    said = []
    for place, (low, high) in zip((sight.u, sight.v), _EDGES, strict=True):
        for name, off in ((low, place < 0), (high, place > 1)):
            share = np.count_nonzero(inside & off) / total
            if share > 0:
                said.append(f"{max(share, 0.001):.1%} looks past its {name} edge")
    away = np.count_nonzero(inside & ~np.isfinite(sight.u)) / total
    if away > 0:
        said.append(f"{max(away, 0.001):.1%} looks away from the screen")
    return ", ".join(said)


def words_of_remedy(sights: Sequence[FacetSight], size_m: FloatArray) -> str:
    """Say how far the screen is to be moved, or how large to be made, for the whole mirror to see it.

    A screen that is made larger grows about its middle.
    size_m (2,): Width and height of the screen as it is [m].
    """
    grown, moved = [], []
    for place, size, (low, high), length in zip(
        ([one.u[one.inside] for one in sights], [one.v[one.inside] for one in sights]),
        size_m.tolist(),
        _EDGES,
        ("wide", "high"),
        strict=True,
    ):
        seen = np.concatenate(place)
        least, most = float(np.nanmin(seen)), float(np.nanmax(seen))
        if most - least > 1:
            needed_m = ceil(1e3 * 2 * max(0.5 - least, most - 0.5) * size) / 1e3
            grown.append(f"make it at least {needed_m:.3f} m {length} instead of {size:.3f} m")
        elif least < 0 or most > 1:
            side, by = (low, -least) if least < 0 else (high, most - 1)
            moved.append(f"move it by {by * size:.3g} m towards its {side} edge")
    if moved:
        moved[-1] += " (or the camera as far to the other side)"
    return " and ".join(grown + moved)


def hole_doubt(sights: Sequence[FacetSight], size_m: FloatArray) -> Doubt | None:
    """Return which part of a mirror will not see the screen, and what to do."""
    holes = [(one.facet.name, hole) for one in sights if (hole := words_of_hole(one))]
    if not holes:
        return None
    inside = sum(np.count_nonzero(one.inside) for one in sights)
    share = sum(np.count_nonzero(one.inside & one.on_screen) for one in sights) / inside
    named = "; ".join(f"{name}: {hole}" for name, hole in holes[:4])
    more = f"; and {len(holes) - 4} facets more" if len(holes) > 4 else ""
    remedy = words_of_remedy(sights, size_m)
    return Doubt(
        "plan_sees_past_screen",
        f"{share:.1%} of the mirror sees the screen ({named}{more}); to see it with the whole mirror "
        f"{remedy or 'turn the mirror towards it'}. Without that the outline ends where the screen does, and "
        "only [mirror.pose] can say where the mirror is",
        {"seen_share": float(share)},
    )
