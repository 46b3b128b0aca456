"""Image points of eliminated targets: by photo, and two by two where they show the same target."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from heliogauge.validate import IntArray


class Run(NamedTuple):
    """Image points of one photo: rows from the first up to the last, which is not among them."""

    photo: int
    first: int
    last: int


class PhotoPair(NamedTuple):
    """Pairs of image points, one in each of two photos: from the first up to the last, which is not among them."""

    photo: int
    other: int
    first: int
    last: int


@dataclass(frozen=True, slots=True, eq=False)
class RayPairs:
    """Pairs of image points of one target, each with itself too, ordered by their photos.

    first, second (q,): Places of the two rays.
    by_photo: The pairs of two photos, for each photo that comes first.
    """

    first: IntArray
    second: IntArray
    by_photo: tuple[tuple[PhotoPair, ...], ...]


@dataclass(frozen=True, eq=False)
class Rays:
    """Image points of eliminated targets; those of one photo stand together, each target once.

    photos, slots (r,): Photo and place among the eliminated targets of each.
    n_photos, n_targets: How many of both there are.
    """

    photos: IntArray
    slots: IntArray
    n_photos: int
    n_targets: int

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """Rays of one photo each."""
        return tuple(runs(self.photos, run_starts(self.photos)))

    @cached_property
    def counts(self) -> IntArray:
        """Rays of each target, shape (e,)."""
        return np.bincount(self.slots, minlength=self.n_targets)

    @cached_property
    def n_pairs(self) -> int:
        """Number of pairs, each ray with itself too."""
        return int((self.counts * (self.counts + 1) // 2).sum())

    @cached_property
    def pairs(self) -> RayPairs:
        """All pairs; takes memory for each of them."""
        order = np.argsort(self.slots, kind="stable")
        place = np.arange(order.size)
        # In the order of the targets every ray is paired with itself and with those of its target that follow.
        left = np.cumsum(self.counts)[self.slots[order]] - place
        begin = np.cumsum(left) - left
        first = np.repeat(place, left)
        second = np.arange(first.size) - np.repeat(begin - place, left)
        first, second = order[first], order[second]
        key = self.photos[first] * self.n_photos + self.photos[second]
        by_photos = np.argsort(key)
        key = key[by_photos]
        bounds = run_starts(key)
        own, other = np.divmod(key[bounds[:-1]], self.n_photos)
        parts = zip(own.tolist(), other.tolist(), pairwise(bounds.tolist()), strict=True)
        listed = [PhotoPair(photo, beside, first, last) for photo, beside, (first, last) in parts]
        groups = run_starts(own).tolist()
        return RayPairs(
            first[by_photos], second[by_photos], tuple(tuple(listed[low:high]) for low, high in pairwise(groups))
        )


def run_starts(values: IntArray) -> IntArray:
    """Return where runs of one value begin, and the number of values last; no more than that without values."""
    return np.concatenate([[0], np.nonzero(np.diff(values))[0] + 1, [values.size]]).astype(np.intp)


def runs(photos: IntArray, starts: IntArray) -> list[Run]:
    """List the runs of image points of one photo each."""
    return [Run(int(photos[first]), first, last) for first, last in pairwise(starts.tolist()) if last > first]
