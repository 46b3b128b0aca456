"""Tracks of natural features: which keypoints of many photos show one point, and which of them are worth keeping."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray, float_array
from photogrammetry.image_points import ImagePoints

#: Before there are residuals, a feature is placed to this share of its size, and never better than the floor [px].
START_SIGMA_SHARE, START_SIGMA_PX = 0.12, 0.1
#: Cells along the longer side of a photo over which kept tracks are spread.
_CELLS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Keypoints:
    """Features of one photo.

    photo: Name of the photo.
    size_px: Its width and height [px].
    pixels_px (n, 2): Places; the centre of the top-left pixel is (0, 0) [px].
    scale_px (n,): Standard deviation of the Gaussian that a feature was found with [px].
    """

    photo: str
    size_px: tuple[int, int]
    pixels_px: FloatArray
    scale_px: FloatArray

    def __post_init__(self) -> None:
        count = len(np.asarray(self.scale_px))
        object.__setattr__(self, "pixels_px", float_array(f"{self.photo}: pixels_px", self.pixels_px, (count, 2)))
        object.__setattr__(self, "scale_px", float_array(f"{self.photo}: scale_px", self.scale_px, (count,)))


@dataclass(frozen=True, slots=True)
class TrackChoice:
    """Which tracks are kept.

    min_photos: Photos that must show a point. Two rays cross wherever the second lies along the first: from three
        on a false match is seen.
    max_points: Points to keep, those seen in most photos first, spread over the photos.
    """

    min_photos: int = 3
    max_points: int = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Natural points and where they are seen.

    points: Image points, named ``n1``, ``n2``, ... with a first guess of their sigma.
    scale_px (m,): Scale of each image point's feature [px].
    ambiguous: Tracks left out that show two places of one photo.
    short: Tracks left out that too few photos show.
    """

    points: ImagePoints
    scale_px: FloatArray
    ambiguous: int
    short: int


class PairMatch(NamedTuple):
    """Two photos, and the keypoints of theirs that show the same, (k, 2)."""

    first: int
    second: int
    keypoints: IntArray


def follow_tracks(
    photos: Sequence[Keypoints], matches: Sequence[PairMatch], choice: TrackChoice | None = None
) -> Tracks:
    """Join matches of pairs of photos to tracks.

    matches: Of all pairs of photos that were compared.
    EstimationError: No track is long enough.

    A track is a connected component of the graph of matches. One false match joins two points to one track, which
    then shows two places of one photo: such tracks are left out whole.
    """
    choice = choice or TrackChoice()
    first = np.concatenate([[0], np.cumsum([one.scale_px.size for one in photos])])
    photo = np.repeat(np.arange(len(photos)), np.diff(first))
    label = _components(int(first[-1]), [first[[one.first, one.second]] + one.keypoints for one in matches])
    count = np.bincount(label)
    pairs, doubled = np.unique(label * len(photos) + photo, return_counts=True)
    bad = np.zeros(count.size, dtype=np.bool_)
    bad[pairs[doubled > 1] // len(photos)] = True
    short = (count < choice.min_photos) & (count > 1)
    fine = np.nonzero(~bad & (count >= choice.min_photos))[0]
    if not fine.size:
        raise EstimationError(
            f"natural: no feature was followed through {choice.min_photos} photos ({int(short.sum())} through fewer, "
            f"{int((bad & (count > 1)).sum())} ambiguous); take photos that overlap more, from nearer places, of a "
            "surface with texture"
        )
    members = np.argsort(label, kind="stable")
    bounds = np.concatenate([[0], np.cumsum(count)])
    pixels, scales = (np.concatenate([getattr(one, name) for one in photos]) for name in ("pixels_px", "scale_px"))
    cells = _cells(photos, photo, pixels)
    order = fine[np.argsort(-count[fine], kind="stable")]
    kept = _spread(order.tolist(), [cells[members[bounds[k] : bounds[k + 1]]] for k in order], choice.max_points)
    rows = np.concatenate([members[bounds[k] : bounds[k + 1]] for k in kept])
    sigma = np.maximum(START_SIGMA_SHARE * scales[rows], START_SIGMA_PX)
    points = ImagePoints(
        tuple(one.photo for one in photos),
        tuple(f"n{number}" for number in range(1, len(kept) + 1)),
        photo[rows],
        np.repeat(np.arange(len(kept)), count[kept]),
        pixels[rows],
        sigma[:, None, None] ** 2 * np.eye(2),
    )
    return Tracks(points, scales[rows], int((bad & (count > 1)).sum()), int(short.sum()))


def _components(count: int, edges: Sequence[IntArray]) -> IntArray:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    both = np.concatenate([np.zeros((0, 2), dtype=np.intp), *edges])
    graph = coo_array((np.ones(len(both), dtype=np.int8), (both[:, 0], both[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def _cells(photos: Sequence[Keypoints], photo: IntArray, pixels: FloatArray) -> IntArray:
    """Return the number of the cell that each keypoint is in; those of different photos differ."""
    longest = np.array([max(one.size_px) for one in photos], dtype=np.float64)[photo]
    place = np.clip((pixels / longest[:, None] * _CELLS).astype(np.intp), 0, _CELLS - 1)
    return np.asarray((photo * _CELLS + place[:, 1]) * _CELLS + place[:, 0])


def _spread(order: Sequence[int], cells: Sequence[IntArray], most: int) -> list[int]:
    """Choose tracks, longest first, that fill cells with few; then cells may hold twice as many, and so on."""
    if len(order) <= most:
        return list(order)
    filled: dict[int, int] = {}
    chosen: list[int] = []
    waiting, limit = list(zip(order, cells, strict=True)), 1
    while len(chosen) < most:
        rest = []
        for track, own in waiting:
            places = own.tolist()
            if len(chosen) < most and min(filled.get(place, 0) for place in places) < limit:
                chosen.append(track)
                for place in places:
                    filled[place] = filled.get(place, 0) + 1
            else:
                rest.append((track, own))
        waiting, limit = rest, 2 * limit
    return chosen
