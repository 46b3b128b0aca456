"""Image points of a photo network: which target was seen where in which photo, and how well."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array


@dataclass(frozen=True, slots=True, eq=False)
class ImagePoints(ShortRepr):
    """Measured image points, one row each, of named targets in named photos.

    Parameters
    ----------
    photos, targets : tuple of str
        Names; a photo or target without a row is allowed.
    photo_index, target_index : array_like of int, shape (m,)
        Which photo and which target each row belongs to.
    pixels_px : array_like, shape (m, 2)
        Image points (x, y); the centre of the top-left pixel is (0, 0) [px].
    covariance_px2 : array_like, shape (m, 2, 2)
        Their covariances [px^2].

    Raises
    ------
    InputError
        A name is repeated, an index has no name, a target appears twice in one photo, or a covariance is not positive
        definite.
    """

    photos: tuple[str, ...]
    targets: tuple[str, ...]
    photo_index: IntArray
    target_index: IntArray
    pixels_px: FloatArray
    covariance_px2: FloatArray

    def __post_init__(self) -> None:
        count = len(np.asarray(self.photo_index))
        for name, names in (("photos", self.photos), ("targets", self.targets)):
            if len(set(names)) != len(names):
                twice = next(one for one in names if names.count(one) > 1)
                raise InputError(f"{name}: {twice!r} is named twice")
            object.__setattr__(self, name, tuple(names))
        for name, size in (("photo_index", len(self.photos)), ("target_index", len(self.targets))):
            index = np.array(getattr(self, name), dtype=np.intp)
            if index.shape != (count,) or (index < 0).any() or (index >= size).any():
                raise InputError(f"{name}: {count} indices below {size} are needed")
            index.setflags(write=False)
            object.__setattr__(self, name, index)
        object.__setattr__(self, "pixels_px", float_array("pixels_px", self.pixels_px, (count, 2)))
        object.__setattr__(self, "covariance_px2", float_array("covariance_px2", self.covariance_px2, (count, 2, 2)))
        self._check_covariances()
        self._check_duplicates()

    def _check_covariances(self) -> None:
        a, b, c = (self.covariance_px2[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
        bad = ~((a > 0) & (a * c - b * b > 0)) | (self.covariance_px2[:, 1, 0] != b)
        if bad.any():
            raise InputError(
                f"covariance_px2: {self.label(int(np.argmax(bad)))}: no positive definite covariance (a sigma of 0?)"
            )

    def _check_duplicates(self) -> None:
        keys = np.sort(self.pair_keys)
        again = keys[1:][keys[1:] == keys[:-1]]
        if again.size:
            rows = np.flatnonzero(self.pair_keys == again[0])
            raise InputError(
                f"{self.label(int(rows[0]))}: measured {rows.size} times; keep one (two sheets with the same codes?)"
            )

    @property
    def n(self) -> int:
        """Number of image points."""
        return int(self.photo_index.size)

    @property
    def pair_keys(self) -> IntArray:
        """One number for each pair of photo and target, shape (m,)."""
        return np.asarray(self.photo_index * max(len(self.targets), 1) + self.target_index)

    @property
    def n_rays(self) -> IntArray:
        """Number of photos that see each target, shape (n_targets,)."""
        return np.bincount(self.target_index, minlength=len(self.targets))

    @property
    def n_targets_in_photo(self) -> IntArray:
        """Number of targets that each photo sees, shape (n_photos,)."""
        return np.bincount(self.photo_index, minlength=len(self.photos))

    def label(self, row: int) -> str:
        """Name one image point for a message."""
        return f"target {self.targets[self.target_index[row]]} in photo {self.photos[self.photo_index[row]]}"

    def subset(self, keep: BoolArray | IntArray) -> "ImagePoints":
        """Return some of the rows (a mask or indices); photos and targets keep their names and order."""
        return ImagePoints(
            self.photos,
            self.targets,
            self.photo_index[keep],
            self.target_index[keep],
            self.pixels_px[keep],
            self.covariance_px2[keep],
        )

    def compacted(self) -> "ImagePoints":
        """Return the same rows without the names of photos and targets that have none."""
        photos, targets = self.n_targets_in_photo > 0, self.n_rays > 0
        return ImagePoints(
            tuple(compress(self.photos, photos)),
            tuple(compress(self.targets, targets)),
            (np.cumsum(photos) - 1)[self.photo_index],
            (np.cumsum(targets) - 1)[self.target_index],
            self.pixels_px,
            self.covariance_px2,
        )

    @classmethod
    def from_names(
        cls, photos: Sequence[str], targets: Sequence[str], pixels_px: npt.ArrayLike, covariance_px2: npt.ArrayLike
    ) -> "ImagePoints":
        """Build image points from the names of photo and target of each row, in the order of first appearance.

        Shapes: photos, targets length m, pixels_px (m, 2), covariance_px2 (m, 2, 2).
        InputError: See `ImagePoints`.
        """
        photo_names, target_names = tuple(dict.fromkeys(photos)), tuple(dict.fromkeys(targets))
        photo_of = {name: i for i, name in enumerate(photo_names)}
        target_of = {name: i for i, name in enumerate(target_names)}
        return cls(
            photo_names,
            target_names,
            np.array([photo_of[name] for name in photos], dtype=np.intp),
            np.array([target_of[name] for name in targets], dtype=np.intp),
            np.asarray(pixels_px, dtype=np.float64),
            np.asarray(covariance_px2, dtype=np.float64),
        )
