"""The canting of each facet of an ensemble, and by how much its mounts are to be moved."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE, Moves, moves_of_mounts
from heliogauge.slopes.normal_angles import tangents
from heliogauge.slopes.statistics import Canting, canting
from heliogauge.validate import FloatArray

#: Tables of a result.
CANTING_FILE, MOUNTS_FILE = "canting.csv", "mounts.csv"
#: What the signs mean, for summary and report.
CANTING_SIGN = (
    "canting is the angle of a facet's mean normal from its design's, in the facet's frame, with the sign of slopes: "
    "positive where the facet rises too much towards +x or +y; moves of mounts are along the normal, positive out of "
    "the mirror, and turn a facet about the middle of its mounts (only differences between the mounts of one matter)"
)


@dataclass(frozen=True, slots=True, eq=False)
class FacetCanting:
    """How one facet points away from its design, and what takes it back.

    facet: The facet with its design.
    measured_share: How much of it was measured.
    canting: The angle between its mean normals; None where less than half of the facet was measured.
    mounts_m (n, 2): Places of its mounts in its own frame; n = 0 where none are given [m].
    moves (n,): Moves of the mounts along the design's normal, positive out of the mirror.
    """

    facet: Facet
    measured_share: float
    canting: Canting | None
    mounts_m: FloatArray
    moves: Moves

    @property
    def mounts_in_ensemble_m(self) -> FloatArray:
        """Places of its mounts on the design's surface in the ensemble's frame, shape (n, 3) [m]."""
        return self.facet.ensemble_from_facet.apply(_on_surface(self.facet, self.mounts_m))

    @property
    def rise_rad(self) -> FloatArray:
        """How much the facet rises too much towards +x and +y of the ensemble's frame, shape (2,) [rad]."""
        if self.canting is None:
            return np.full(2, np.nan)
        along = np.tensordot(self.canting.components_rad, _axes(self.facet), axes=1)
        return np.asarray(self.facet.ensemble_from_facet.rotate(along)[:2])


def canting_of_facets(
    facets: Sequence[Facet], as_measured: Mapping[str, SlopeMap], mounts_m: Mapping[str, FloatArray]
) -> tuple[FacetCanting, ...]:
    """Compare each facet's mean normal with its design's, and prescribe the moves of its mounts.

    facets: All facets of the ensemble, measured or not.
    as_measured: The map of each measured facet, with nothing removed.
    mounts_m (n, 2): Places of the mounts of each facet in its frame; facets without are left out [m].
    """
    found = []
    for facet in facets:
        slope_map = as_measured.get(facet.name)
        share = 0.0 if slope_map is None else slope_map.measured_share
        canted = canting(slope_map) if slope_map is not None and share >= LEAST_SHARE else None
        places = mounts_m.get(facet.name, np.zeros((0, 2)))
        found.append(FacetCanting(facet, share, canted, places, moves_of_facet(facet, canted, places)))
    return tuple(found)


def moves_of_facet(facet: Facet, canted: Canting | None, mounts_m: FloatArray) -> Moves:
    """Return the moves that take the canting back; the facet turns about the middle of its mounts."""
    count = len(mounts_m)
    if canted is None or not count:
        return Moves(np.full(count, np.nan), np.full(count, np.nan))
    places = _on_surface(facet, mounts_m)
    # Along the surface's tangents: the turn is one of the normal, not of dz/dx.
    levers = (places - places.mean(axis=0)) @ _axes(facet).T
    turns = np.broadcast_to(canted.components_rad, (count, 2))
    return moves_of_mounts(levers, turns, np.broadcast_to(canted.covariance_components_rad2, (count, 2, 2)))


def _on_surface(facet: Facet, places_m: FloatArray) -> FloatArray:
    x, y = places_m.T
    return np.stack([x, y, facet.design.height(x, y)], axis=1)


def _axes(facet: Facet) -> FloatArray:
    """Return e_x and e_y across the design's normal at the reference point, shape (2, 3)."""
    slope_x, slope_y = facet.design.gradient(*facet.reference_point_m)
    return tangents(np.asarray(slope_x), np.asarray(slope_y))


def doubt_of_canting(cantings: Sequence[FacetCanting]) -> Doubt | None:
    """Return which facets have no canting, and so no prescription."""
    unknown = [one.facet.name for one in cantings if one.canting is None]
    if not unknown:
        return None
    return Doubt(
        "facets_without_canting",
        f"{len(unknown)} of {len(cantings)} facets are measured on less than {100 * LEAST_SHARE:.0f} %: no canting and "
        f"no moves of mounts for {', '.join(unknown[:5])}{' ...' if len(unknown) > 5 else ''}",
        {"unknown_count": len(unknown), "facets_count": len(cantings)},
    )
