"""Where the samples of a source lie in the image: on every pixel, or on a lattice of dots."""

from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from heliogauge.validate import FloatArray, IntArray, float_array, freeze

#: Column and row of what lies beyond all samples.
_BEYOND = -9.0

_Value = TypeVar("_Value", bound=np.generic)


class SampleGrid(Protocol):
    """Rows and columns of samples, and where each is in the image."""

    @property
    def spacing_px(self) -> float:
        """Usual distance of neighbouring samples in the image [px]."""

    def pixels_px(self, row: IntArray, column: IntArray) -> FloatArray:
        """Return where samples are in the image, shape (n, 2) [px]."""

    def places(self, pixels_px: FloatArray) -> FloatArray:
        """Return the column and row, with fractions, of positions in the image, shape (n, 2); negative beyond."""

    def of_image(self, image: npt.NDArray[_Value], beyond: Any) -> npt.NDArray[_Value]:
        """Return what an image (h, w) says at each sample.

        beyond: What holds for a sample without a place in the image.
        """


@dataclass(frozen=True, slots=True)
class PixelGrid:
    """A sample on every pixel."""

    @property
    def spacing_px(self) -> float:
        """Usual distance of neighbouring samples in the image [px]."""
        return 1.0

    def pixels_px(self, row: IntArray, column: IntArray) -> FloatArray:
        """Return where samples are in the image, shape (n, 2) [px]."""
        return np.stack([column, row], axis=-1).astype(np.float64)

    def places(self, pixels_px: FloatArray) -> FloatArray:
        """Return the column and row of positions in the image: the positions themselves."""
        return pixels_px

    def of_image(self, image: npt.NDArray[_Value], beyond: Any) -> npt.NDArray[_Value]:
        """Return the image itself."""
        return image


@dataclass(frozen=True, slots=True, eq=False)
class LatticeGrid:
    """Samples in rows and columns that are nearly straight in the image.

    places_px (rows, columns, 2): Where each sample is in the image; NaN where there is none [px].
    n_blocks: How many lattices stand below each other, each with as many rows: nothing is between them.
    """

    places_px: FloatArray
    n_blocks: int = 1
    _inverse: list[Any] = field(init=False, repr=False, default_factory=list)

    def __post_init__(self) -> None:
        places = float_array("places_px", self.places_px, (None, None, 2), finite=False)
        object.__setattr__(self, "places_px", freeze(places))

    @property
    def spacing_px(self) -> float:
        """Usual distance of neighbouring samples in the image [px]."""
        steps = [np.linalg.norm(np.diff(self.places_px, axis=axis), axis=-1) for axis in (0, 1)]
        across, down = (float(np.nanmedian(one)) for one in steps)
        return float(np.sqrt(across * down))

    def pixels_px(self, row: IntArray, column: IntArray) -> FloatArray:
        """Return where samples are in the image, shape (n, 2) [px]."""
        return np.asarray(self.places_px[row, column])

    def places(self, pixels_px: FloatArray) -> FloatArray:
        """Return the column and row, with fractions, of positions in the image, shape (n, 2); negative beyond.

        Between the samples by Clough and Tocher's cubic over their triangles, which has no kinks.
        """
        if not self._inverse:
            from scipy.interpolate import CloughTocher2DInterpolator

            all_rows, all_columns = np.nonzero(np.isfinite(self.places_px[..., 0]))
            block = all_rows // (self.places_px.shape[0] // self.n_blocks)
            for one in np.unique(block):
                row, column = all_rows[block == one], all_columns[block == one]
                index = np.stack([column, row], axis=-1).astype(np.float64)
                self._inverse.append(CloughTocher2DInterpolator(self.places_px[row, column], index))
        found = np.asarray(self._inverse[0](pixels_px))
        for inverse in self._inverse[1:]:
            beyond = np.isnan(found[..., 0])
            found[beyond] = inverse(pixels_px[beyond])
        return np.asarray(np.nan_to_num(found, nan=_BEYOND))

    def of_image(self, image: npt.NDArray[_Value], beyond: Any) -> npt.NDArray[_Value]:
        """Return the image's value at the pixel nearest to each sample."""
        height, width = image.shape
        nearest = np.rint(np.nan_to_num(self.places_px, nan=-1.0)).astype(np.intp)
        column, row = nearest[..., 0], nearest[..., 1]
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        values = image[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, values, np.asarray(beyond, dtype=image.dtype))
