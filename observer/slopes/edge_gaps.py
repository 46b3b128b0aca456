"""How far apart the edges of the reflection are: between them slopes are what the mirror's smoothness lets expect."""

from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.validate import BoolArray, FloatArray
from observer.doubts.photos import FAR_M
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, nodes_of

#: Slopes of troughs are wanted to a tenth of a milliradian [rad].
_WANTED_RAD = 1e-4
#: Where fewer edges than this share are foretold by the others as well as they are measured, nothing checks the most.
_CHECKED_SHARE = 0.5
#: Roughness of a usual mirror [rad^2 / m^3], the middle of those that `observer.slopes.joint_solution` knows: few edges
#: may look as if they lay on a straight line.
_USUAL_ROUGHNESS = 3e-4
#: Of the gaps this share is narrower than the one that is told.
_USUAL_GAPS = 0.9


@dataclass(frozen=True, slots=True)
class EdgeGaps:
    """What lies between edges.

    gap_m: Nine of ten neighbouring edges of a row of a panel are nearer than this [m].
    confirmed_share: Share of the edges that the others foretell about as well as they are measured.
    """

    gap_m: float
    confirmed_share: float

    @property
    def strays_rad(self) -> float:
        """How far a usual mirror strays in the middle of a gap [rad]."""
        return float(np.sqrt(_USUAL_ROUGHNESS * self.gap_m**3 / 192))

    def leave_open(self, own_rad: float) -> bool:
        """Return whether slopes rest on the smoothness of the mirror more than on the photos.

        own_rad: What noise and the distance to the next edge usually leave uncertain of a slope [rad].
        """
        is_known = self.confirmed_share > _CHECKED_SHARE or own_rad < _WANTED_RAD
        return not (self.strays_rad < _WANTED_RAD and is_known)


def edge_gaps(lines: TouchingLines, grid: RowGrid, confirmed: BoolArray) -> EdgeGaps:
    """Return how far apart edges are.

    confirmed (m,): Whether the other edges foretell each.
    """
    piece = np.concatenate([[0], np.cumsum(~grid.joined)])
    before, share = nodes_of(grid, lines.x_m)
    panel = piece[before + (share > 0.5)]
    order = np.lexsort((lines.x_m, panel, lines.row))
    same = (np.diff(lines.row[order]) == 0) & (np.diff(panel[order]) == 0)
    gaps = np.diff(lines.x_m[order])[same]
    return EdgeGaps(
        float(np.quantile(gaps, _USUAL_GAPS)) if gaps.size else np.inf,
        float(confirmed.mean()) if confirmed.size else 0.0,
    )


def gaps_doubt(found: EdgeGaps, roughness: Roughness, own_sigma_rad: FloatArray, eyes_m: FloatArray) -> Doubt | None:
    """Say whether slopes rest on the smoothness of the mirror more than on the photos.

    Shapes: eyes_m (n, 3).
    own_sigma_rad (k,): What noise and the distance to the next edge leave uncertain of each slope [rad].
    Returns: Nothing where the usual slope is known to a tenth of a milliradian, or most edges are confirmed by others,
        and the gaps are so narrow that a usual mirror strays by no more.

    In the middle of a gap g, whose bend is a random walk of the density q, a slope that is known at both ends with its
    bend is uncertain by ``sqrt(q g^3 / 192)``. That of a walk that is integrated n - 1 times grows with
    ``g^(n - 1/2)``: so much nearer photos must be for the wanted one.
    """
    own = float(np.median(own_sigma_rad)) if own_sigma_rad.size else np.inf
    if not found.leave_open(own):
        return None
    usual = max(own, found.strays_rad)
    steps = np.diff(np.sort(eyes_m[:, 0]))
    step = float(np.median(steps)) if steps.size else 0.0
    nearer = (_WANTED_RAD / usual) ** (1 / (roughness.order - 0.5))
    away = float(np.median(np.linalg.norm(eyes_m, axis=1)))
    apart, remedy = f"{step:.2f} m", f"take photos at most {nearer * step:.2g} m apart across the trough"
    if away > FAR_M:
        # A camera that stands still sees the collector turn.
        turn_deg = float(np.degrees(step / away))
        apart, remedy = f"{turn_deg:.2g} deg", f"let it turn by at most {nearer * turn_deg:.2g} deg from photo to photo"
    return Doubt(
        "slopes_rest_on_smoothness",
        f"photos some {apart} apart leave up to {found.gap_m:.2f} m between edges of the reflection: slopes there rest "
        f"on how smooth the mirror is beside (+- {1e3 * usual:.2f} mrad), and {100 * found.confirmed_share:.0f} % of "
        "the edges are confirmed by others. A wave or dent between edges is not seen, a wrong one not noticed; "
        f"for {1e3 * _WANTED_RAD:g} mrad {remedy}",
        {
            "usual_step_m": step,
            "gap_m": found.gap_m,
            "sigma_between_rad": usual,
            "confirmed_share": found.confirmed_share,
            "needed_step_m": nearer * step,
        },
    )
