"""How light that reaches a trough is spread across it: the sun shape seen edge on, widened by scatter and tracking.

A trough concentrates in one direction only. What counts is the angle across the trough, that is, the sun shape summed
along lines parallel to the trough, and Gaussian errors on top of it.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.sunlight.sun_shapes import SunShape
from heliogauge.validate import FloatArray, float_array, freeze

#: Nodes of the table. Linear interpolation of the steepest usual sun (pillbox of 4.65 mrad in a table that reaches to
#: 5 mrad) errs by less than 1e-7 of the power; of Buie's, whose table reaches to 44 mrad, by less than 1e-6.
_NODES = 8193
#: Rings that the sun is cut into; each has even radiance.
_RINGS = 600
#: Standard deviations of the Gaussian part that are kept: 2e-9 of the power lies beyond.
_REACH = 6.0


class _Table(NamedTuple):
    """Values at equally spaced angles, and how much each differs from the one before, shapes (n,) and (n - 1,)."""

    values: FloatArray
    steps: FloatArray


def _table(values: FloatArray) -> _Table:
    return _Table(freeze(values), freeze(np.diff(values)))


@dataclass(frozen=True, slots=True, eq=False)
class BeamProfile:
    """Share of the light that comes from below an angle across the trough.

    angle_rad (n,): Equally spaced angles about the sun's centre [rad].
    share_below (n,): Cumulative share of the power, 0 to 1.
    words: What it is made of.
    """

    angle_rad: FloatArray
    share_below: FloatArray
    words: str
    _below: "_Table" = field(init=False, repr=False)
    _density: "_Table" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle_rad", float_array("angle_rad", self.angle_rad, (None,)))
        object.__setattr__(self, "share_below", float_array("share_below", self.share_below, self.angle_rad.shape))
        object.__setattr__(self, "_below", _table(self.share_below))
        object.__setattr__(self, "_density", _table(np.gradient(self.share_below, self.step_rad)))

    @property
    def step_rad(self) -> float:
        """Distance of the table's angles [rad]."""
        return float(self.angle_rad[-1] - self.angle_rad[0]) / (self.angle_rad.size - 1)

    @property
    def density(self) -> FloatArray:
        """Share of the power per angle at the table's angles, shape (n,) [1/rad]."""
        return self._density.values

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the angle [rad]."""
        middle = 0.5 * (self.angle_rad[1:] + self.angle_rad[:-1])
        power = np.diff(self.share_below)
        return float(np.sqrt(power @ middle**2 - (power @ middle) ** 2))

    def below(self, angle_rad: npt.ArrayLike) -> FloatArray:
        """Return the share of the light from below angles.

        angle_rad (...): Angles from the sun's centre [rad].
        Returns (...): Between 0 and 1.
        """
        return self._looked_up(self._below, angle_rad)

    def density_at(self, angle_rad: npt.ArrayLike) -> FloatArray:
        """Return the share of the light per angle.

        Shapes: result (...).
        angle_rad (...): Angles from the sun's centre [rad].
        """
        return self._looked_up(self._density, angle_rad)

    def _looked_up(self, table: "_Table", angle_rad: npt.ArrayLike) -> FloatArray:
        # Equal steps: four times as fast as np.interp for angles in no order.
        place = np.atleast_1d((np.asarray(angle_rad, dtype=np.float64) - self.angle_rad[0]) / self.step_rad)
        # A share of the last step is left, so that there is a table entry after each.
        np.clip(place, 0.0, (table.values.size - 1) * (1 - 1e-12), out=place)
        before = place.astype(np.int32)
        place -= before
        place *= table.steps.take(before)
        place += table.values.take(before)
        return place.reshape(np.shape(angle_rad))


def sun_profile(sun: SunShape) -> BeamProfile:
    """Look at a sun shape edge on.

    sun: Radiance about the sun's centre.
    Returns: Its share below each angle.

    The sun is cut into rings of even radiance, each the difference of two discs. Of a disc of radius R the share
    ``1/2 + (t sqrt(1 - t^2) + asin t) / pi`` lies below ``t = u / R``. That is exact for a pillbox; rings of 1/600 of
    the limit make errors below 1e-6 for the other shapes.
    """
    limit = sun.limit_rad
    edges = np.linspace(0.0, limit, _RINGS + 1)
    power = np.diff(sun.share_within(edges))
    square = edges**2
    per_area = power / np.diff(square)
    # Sum over rings of (R_k^2 disc_k - R_(k-1)^2 disc_(k-1)) per_area_k, gathered by disc.
    weight = square[1:] * (per_area - np.append(per_area[1:], 0.0))
    # One half is enough, for the shape is symmetric.
    angle = np.linspace(0.0, limit, _NODES // 2 + 1)
    above = np.zeros(angle.size)
    for radius, share in zip(edges[1:], weight, strict=True):
        inside = angle[angle < radius] / radius
        above[: inside.size] += share * (np.arccos(inside) - inside * np.sqrt(1 - inside**2)) / np.pi
    whole = np.concatenate([-angle[:0:-1], angle])
    return BeamProfile(whole, np.concatenate([above[:0:-1], 1.0 - above]), sun.describe())


def beam_profile(
    sun: BeamProfile, *, specularity_rad: float = 0.0, tracking_error_rad: float = 0.0, incidence_rad: float = 0.0
) -> BeamProfile:
    """Widen a sun by scatter and tracking, and by its incidence along the trough.

    specularity_rad: Gaussian scatter of the reflected beam in one direction, 1 sigma [rad].
    tracking_error_rad: Gaussian error of the collector's rotation about its length, 1 sigma [rad].
    incidence_rad: Angle between the sun and the plane across the trough [rad].
    Returns: The light's angles across the trough.
    InputError: A negative scatter, or a sun that stands along the trough.

    A sun at the incidence angle i is seen from the plane across the trough with ``tan(angle) = deviation / cos i``:
    sun shape and specularity are widened by 1 / cos i. Tracking and the mirror's slope errors across are not, for
    reflection at a normal without part along the trough keeps the length of the rays' part along it.
    """
    if min(specularity_rad, tracking_error_rad) < 0:
        raise InputError(
            f"specularity {specularity_rad:g} rad, tracking error {tracking_error_rad:g} rad: neither can be negative"
        )
    if not abs(incidence_rad) < 1.4:
        raise InputError(f"incidence_rad: {incidence_rad:g} rad; a sun within 80 degrees of the cross plane is needed")
    stretch = 1.0 / np.cos(incidence_rad)
    sigma = float(np.hypot(specularity_rad * stretch, tracking_error_rad))
    words = (
        f"{sun.words}, specularity {1e3 * specularity_rad:.3g} mrad, tracking error {1e3 * tracking_error_rad:.3g} mrad"
    )
    if incidence_rad:
        words += f", incidence {np.degrees(incidence_rad):.3g} degrees"
    reach = stretch * sun.angle_rad[-1] + _REACH * sigma
    angle = np.linspace(-reach, reach, _NODES)
    share = sun.below(angle / stretch)
    return BeamProfile(angle, _blurred(share, sigma / (angle[1] - angle[0])), words)


def _blurred(share: FloatArray, sigma_steps: float) -> FloatArray:
    """Convolve a cumulative share with a Gaussian of a given width in steps."""
    if sigma_steps == 0:
        return share
    half = int(np.ceil(_REACH * sigma_steps))
    # Half the sum of the Gaussian below each step's borders; importing scipy's error function takes longer than all.
    below = np.array([math.erf((i - 0.5) / (math.sqrt(2.0) * sigma_steps)) for i in range(-half, half + 2)])
    kernel = np.diff(below)
    padded = np.concatenate([np.zeros(half), share, np.ones(half)])
    # As a product of spectra: the direct sum of thousands by thousands costs a hundred times as much.
    size = 1 << (padded.size + kernel.size - 1).bit_length()
    product = np.fft.rfft(padded, size) * np.fft.rfft(kernel / kernel.sum(), size)
    return np.asarray(np.fft.irfft(product, size)[2 * half : 2 * half + share.size])
