"""Each stated edge of the panels beside where photos show it, in both directions; wide where it is not found near."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from heliogauge.validate import Float32Array
from observer.corners.lattice import PanelLattice, PanelLine
from observer.corners.panel_lines import FoundLine, line_pieces, lines_in, normals_at, photo_noise
from observer.photo_edges.views import View

#: How far beside its prediction an edge is looked for, and one that is not found there [px].
_REACHES_PX = (6.0, 24.0)
#: Beside the drawing by so many standard deviations of the usual mounting an edge is not where it is stated: by chance
#: one in 10^4. Photos that show it so near each other agree.
_BESIDE = 4.0
#: With less than this share of its pieces in photos in one place an edge is not seen.
_LEAST_SHARE = 0.5
#: Fewer of its lines in photos say nothing of an edge: any one may be hidden, or be another line.
_FEWEST_LINES = 3


class StatedEdge(NamedTuple):
    """An entry of panel_edges_x_m or panel_edges_y_m beside the photos.

    axis, number: 0 for x and 1 for y, and which entry.
    beside_m: How far it lies beside the drawing in the photos [m]; NaN where it is not seen.
    seen_ratio: Share of its lines in photos that show it in one place.
    limit_m: What is still usual [m].
    is_rim: Whether the mirror ends there.
    """

    axis: int
    number: int
    beside_m: float
    seen_ratio: float
    limit_m: float
    is_rim: bool

    @property
    def is_seen(self) -> bool:
        """Whether most of what should show it does, in one place."""
        return self.seen_ratio >= _LEAST_SHARE

    @property
    def is_beside(self) -> bool:
        """Whether it is seen, elsewhere than stated."""
        return self.is_seen and abs(self.beside_m) > self.limit_m


def stated_edges(
    read: Callable[[int], Float32Array], views: Sequence[View], lattice: PanelLattice
) -> tuple[StatedEdge, ...]:
    """Return each entry that at least three lines in photos should show, beside where photos show it.

    read: Returns a photo by its number.
    views: Camera and pose of each photo.
    """
    near, far = _REACHES_PX
    found = _looked_for(read, views, lattice, lattice.lines, near)
    # An edge farther away leaves its flank, or nothing, at the end of the window.
    doubtful = {(one.axis, one.number) for one in found if not one.is_seen or one.is_beside}
    wanted = tuple(line for line in lattice.lines if (line.axis, line.number) in doubtful)
    again = _looked_for(read, views, lattice, wanted, far) if wanted else ()
    wide = {(one.axis, one.number): one for one in again}
    return tuple(wide.get((one.axis, one.number), one) for one in found)


def strange_edges(edges: Sequence[StatedEdge]) -> tuple[StatedEdge, ...]:
    """Return those that are elsewhere than stated, and joints that are not seen while most others of their axis are.

    Joints along one axis may be closed. A rim that is not seen may have a background as bright as the mirror.
    """
    mostly_seen = [
        np.mean([one.is_seen for one in edges if one.axis == axis and not one.is_rim] or 0) for axis in (0, 1)
    ]
    return tuple(
        one for one in edges if one.is_beside or not (one.is_seen or one.is_rim or mostly_seen[one.axis] <= 0.5)
    )


def _looked_for(
    read: Callable[[int], Float32Array],
    views: Sequence[View],
    lattice: PanelLattice,
    lines: Sequence[PanelLine],
    reach_px: float,
) -> tuple[StatedEdge, ...]:
    parts, noise = [], []
    for number, view in enumerate(views):
        image = read(number)
        parts.append(line_pieces(image, view, lattice, lines, reach_px))
        noise.append(photo_noise(image))
    looked = lines_in(parts, lines, noise)
    beside_m = [_beside_m(found, view, lattice) for (found, _), view in zip(looked, views, strict=True)]
    edges: list[StatedEdge] = []
    for axis, number in dict.fromkeys((line.axis, line.number) for line in lines):
        own = [k for k, line in enumerate(lines) if (line.axis, line.number) == (axis, number)]
        shown = sum(int(np.count_nonzero(pieces[own])) for _, pieces in looked)
        if shown < _FEWEST_LINES:
            continue
        beside = np.array([one for places in beside_m for one in (places[k] for k in own) if one is not None])
        is_rim = lines[own[0]].is_rim
        # A joint is the mean of two panels' edges.
        sides = 1 if is_rim else 2
        limit_m = _BESIDE * float(np.hypot(lattice.mounting_sigma_m, lattice.corner_sigma_m)) / sides**0.5
        middle = float(np.median(beside)) if beside.size else np.nan
        share = float(np.count_nonzero(np.abs(beside - middle) < limit_m)) / shown
        edges.append(StatedEdge(axis, number, middle if share >= _LEAST_SHARE else np.nan, share, limit_m, is_rim))
    return tuple(edges)


def _beside_m(found: Sequence[FoundLine | None], view: View, lattice: PanelLattice) -> list[float | None]:
    """Return how far beside the drawing, in x or y, a photo shows lines; they lie on the mirror there too [m]."""
    shown = [one for one in found if one is not None]
    if not shown:
        return [None] * len(found)
    lines, number, middle = [one.line for one in shown], np.arange(len(shown)), np.array([one.middle for one in shown])
    _, normals = normals_at(view, lattice, lines, number, middle)
    points = lattice.on_lines(lines, number, middle)
    across = np.array([line.axis == 0 for line in lines])
    slopes = points[:, 0] / (2 * lattice.collector.focal_length_m)
    ways = np.stack([1.0 * across, 1.0 * ~across, across * slopes], axis=1)
    by_place = view.camera.project_posed(points, view.cam_from_frame).d_pixel_d_point @ ways[..., None]
    offsets = np.array([one.offset_px for one in shown])
    beside = iter((offsets / np.einsum("kp,kp->k", normals, by_place[..., 0])).tolist())
    return [None if one is None else next(beside) for one in found]
