"""What was found in one photo: names, places with covariances, sizes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.flags import REJECTED
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FlagArray, FloatArray, IntArray, float_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class Detections(ShortRepr):
    """Image points of one photo.

    photo: Name of the photo.
    names length n: Ring-coded targets by their number ("65"), corners of square markers by marker and corner in the
        marker's own order ("23.0" to "23.3"), targets without a code by a count in this photo ("u7") until they are
        matched.
    pixels_px (n, 2): Centres (x, y); (0, 0) is the centre of the top-left pixel [px].
    covariance_px2 (n, 2, 2): Covariance of each centre [px^2].
    radius_px (n,): Geometric mean of the semi-axes of the target's ellipse; NaN for corners [px].
    flags (n,): Bit masks of `SampleFlag`.
    InputError: Lengths differ, or a point without a rejecting flag has no finite place and covariance.

    >>> one = Detections("a.jpg", ("65",), np.array([[4.0, 3.0]]), np.eye(2)[None] * 1e-4, np.array([6.0]),
    ...                  np.zeros(1, dtype=np.uint32))
    >>> one.sigma_px
    array([[0.01, 0.01]])
    """

    photo: str
    names: tuple[str, ...]
    pixels_px: FloatArray
    covariance_px2: FloatArray
    radius_px: FloatArray
    flags: FlagArray

    def __post_init__(self) -> None:
        n = len(self.names)
        where = f"{self.photo}: "
        pixels = float_array(where + "pixels_px", self.pixels_px, (n, 2), finite=False)
        covariance = float_array(where + "covariance_px2", self.covariance_px2, (n, 2, 2), finite=False)
        radius = float_array(where + "radius_px", self.radius_px, (n,), finite=False)
        flags = np.array(self.flags, dtype=np.uint32)
        if flags.shape != (n,):
            raise InputError(f"{where}flags: shape ({n},) is needed, not {flags.shape}")
        kept = (flags & np.uint32(REJECTED)) == 0
        missing = kept & ~(np.isfinite(pixels).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
        if missing.any():
            first = self.names[int(np.argmax(missing))]
            raise InputError(f"{where}{first}: a point that is not rejected needs a finite place and covariance")
        for name, value in (("pixels_px", pixels), ("covariance_px2", covariance), ("radius_px", radius)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "flags", freeze(flags))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def sigma_px(self) -> FloatArray:
        """Standard deviations of x and y, shape (n, 2) [px]."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))

    @property
    def usable(self) -> BoolArray:
        """True where no flag rejects the point, shape (n,)."""
        return np.asarray((self.flags & np.uint32(REJECTED)) == 0)

    @property
    def duplicated(self) -> tuple[str, ...]:
        """Names that occur more than once in this photo, in order of their first occurrence."""
        return tuple(name for name, count in Counter(self.names).items() if count > 1)

    def chosen(self, which: npt.NDArray[np.bool_] | IntArray | Sequence[int]) -> "Detections":
        """Return some of the points.

        which (n,): A mask or indices.
        """
        index = np.arange(len(self))[np.asarray(which)]
        return Detections(
            self.photo,
            tuple(self.names[k] for k in index),
            self.pixels_px[index],
            self.covariance_px2[index],
            self.radius_px[index],
            self.flags[index],
        )

    def renamed(self, names: Sequence[str]) -> "Detections":
        """Return the same points under other names, one for each."""
        return replace(self, names=tuple(names))

    def joined(self, other: "Detections") -> "Detections":
        """Return these points and then the others of the same photo."""
        return Detections(
            self.photo,
            self.names + other.names,
            np.concatenate([self.pixels_px, other.pixels_px]),
            np.concatenate([self.covariance_px2, other.covariance_px2]),
            np.concatenate([self.radius_px, other.radius_px]),
            np.concatenate([self.flags, other.flags]),
        )
