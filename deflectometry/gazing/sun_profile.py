"""The sun as a camera measured it: radiance over the angle from its centre."""

from dataclasses import dataclass, field, replace

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray, float_array, freeze

#: Steps of the table that is read at millions of angles; over 10 mrad a step is 2.4 urad.
_TABLE_STEPS = 4096
#: The profile is measured to so many radii of the disc; a limb that is not sharp ends before.
_REACH_RADII = 2.0
#: Share of the disc within which the level of its middle is taken.
_MIDDLE_SHARE = 0.15
#: A disc of fewer pixels across gives no profile: half a pixel of blur is 3 % of its radius.
_LEAST_RADIUS_PX = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class SunProfile:
    """Radiance relative to the middle of the disc, smooth between measured angles, even beyond the last.

    angle_rad (n,): Ascending angles from the centre, the first 0 [rad].
    relative (n,): Radiance there, 1 in the middle.
    steps (n, k): What one sigma of each independent source of error does to it; None: exactly known.
    """

    angle_rad: FloatArray
    relative: FloatArray
    steps: FloatArray | None = None
    _values: FloatArray = field(init=False, repr=False)
    _slopes: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline

        angle = float_array("angle_rad", self.angle_rad, (None,))
        relative = float_array("relative", self.relative, (angle.size,))
        # Flat in the middle, where all directions are alike.
        smooth = CubicSpline(angle, relative, bc_type=((1, 0.0), (2, 0.0)))
        nodes = np.linspace(0.0, angle[-1], _TABLE_STEPS + 1)
        # One node more: beyond the last angle the sky is as bright as there.
        values = np.append(smooth(nodes), relative[-1])
        object.__setattr__(self, "angle_rad", angle)
        object.__setattr__(self, "relative", relative)
        object.__setattr__(self, "_values", freeze(values))
        object.__setattr__(self, "_slopes", freeze(np.diff(values, append=relative[-1])))

    def steps_at(self, angle_rad: FloatArray) -> FloatArray:
        """Return what one sigma of each source of error adds at angles of any shape, shape (..., k)."""
        from scipy.interpolate import CubicSpline

        if self.steps is None:
            return np.zeros((*angle_rad.shape, 0))
        flat = np.zeros(self.steps.shape[1])
        each = CubicSpline(self.angle_rad, self.steps, bc_type=((1, flat), (2, flat)))
        return np.asarray(each(np.minimum(angle_rad, self.limit_rad)))

    def adjusted(self, amounts: FloatArray) -> "SunProfile":
        """Return the profile with each source of error by an amount (k,) of its sigmas elsewhere."""
        return self if self.steps is None else replace(self, relative=self.relative + self.steps @ amounts)

    @property
    def limit_rad(self) -> float:
        """Angle beyond which it was not measured [rad]."""
        return float(self.angle_rad[-1])

    @property
    def radius_rad(self) -> float:
        """Angle at which the radiance has fallen to half of the middle's [rad]."""
        below = np.flatnonzero(self._values < 0.5)
        return float(below[0]) * self.limit_rad / _TABLE_STEPS

    def at(self, angle_rad: FloatArray) -> FloatArray:
        """Return the relative radiance at angles of any shape."""
        place = angle_rad * (_TABLE_STEPS / self.limit_rad)
        place = np.minimum(place, float(_TABLE_STEPS + 1))
        index: IntArray = place.astype(np.intp)
        return np.asarray(self._values.take(index) + (place - index) * self._slopes.take(index))

    def derivative(self, angle_rad: FloatArray) -> FloatArray:
        """Return its derivative over the angle, of any shape [1/rad]."""
        scale = _TABLE_STEPS / self.limit_rad
        index = np.minimum(angle_rad * scale, float(_TABLE_STEPS + 1)).astype(np.intp)
        return np.asarray(scale * self._slopes.take(index))


@dataclass(frozen=True, slots=True, eq=False)
class SunImage:
    """What an image of the sun gives.

    profile: Radiance over the angle.
    level: Light in the middle of the disc, per millisecond.
    sigma_level: Its standard deviation.
    radius_px: Of the disc at half the light.
    """

    profile: SunProfile
    level: float
    sigma_level: float
    radius_px: float

    @property
    def sigma_radius_rad(self) -> float:
        """What noise of the image makes of the profile's radius [rad]."""
        at = np.array(self.profile.radius_rad)
        noise = float(np.linalg.norm(self.profile.steps_at(at)))
        return float(np.hypot(noise, 0.5 * self.sigma_level / self.level) / abs(self.profile.derivative(at)))


def measure_sun(light: FloatArray, focal_px: float, what: str) -> SunImage:
    """Measure level and profile of the sun in a dark-corrected image.

    light (h, w): Light of each pixel; NaN where saturated.
    what: Where the image comes from, for messages.
    EstimationError: No disc, one at the border, saturated, or one that is not round (a cloud before it).

    The centre is that of the pixels above half of the level; means over rings of one pixel follow the profile. The
    disc's own pixels blur it by half a pixel.
    """
    finite = np.isfinite(light)
    if not finite.any() or float(np.nanmax(light)) <= 0:
        raise EstimationError(f"{what}: no sun is in the image")
    if np.count_nonzero(~finite) > 0.01 * np.count_nonzero(np.where(finite, light, np.inf) > 0.5 * np.nanmax(light)):
        raise EstimationError(f"{what}: the sun is saturated; take it with a shorter exposure or a denser filter")
    half = 0.5 * float(np.nanpercentile(light[light > 0.5 * np.nanmax(light)], 75))
    lit = np.where(finite, light, 0.0) > half
    rows, columns = np.nonzero(lit)
    radius = float(np.sqrt(np.count_nonzero(lit) / np.pi))
    if radius < _LEAST_RADIUS_PX:
        raise EstimationError(
            f"{what}: the sun's disc is {2 * radius:.0f} px wide; {2 * _LEAST_RADIUS_PX:.0f} are needed for a profile"
        )
    centre_x, centre_y = float(columns.mean()), float(rows.mean())
    reach = _REACH_RADII * radius
    height, width = light.shape
    if not (reach <= centre_x <= width - 1 - reach and reach <= centre_y <= height - 1 - reach):
        raise EstimationError(f"{what}: the sun is at the border of the image; point the camera at it")
    y, x = np.mgrid[
        int(centre_y - reach) : int(centre_y + reach) + 2, int(centre_x - reach) : int(centre_x + reach) + 2
    ]
    part = light[y[0, 0] : y[-1, 0] + 1, x[0, 0] : x[0, -1] + 1]
    distance = np.hypot(x - centre_x, y - centre_y)
    _refuse_uneven(part, distance / radius, np.arctan2(y - centre_y, x - centre_x), what)
    ring = np.rint(distance).astype(np.intp)
    used = np.isfinite(part) & (ring <= reach)
    count = np.bincount(ring[used])
    mean = np.bincount(ring[used], part[used]) / count
    middle = used & (distance <= np.sqrt(_MIDDLE_SHARE) * radius)
    level = float(part[middle].mean())
    sigma = float(part[middle].std() / np.sqrt(np.count_nonzero(middle)))
    # The aureole around the disc stays in: the mirror shows it, too.
    relative = mean / level
    at = np.bincount(ring[used], distance[used]) / count
    variance = _ring_variance(part[used], distance[used] - at[ring[used]], ring[used])
    at[0], relative[0] = 0.0, relative[:3] @ count[:3] / count[:3].sum()
    sigma_ring = np.sqrt(variance / np.append(count[:3].sum(), count[1:])) / level
    angle = np.arctan(at / focal_px)
    return SunImage(SunProfile(angle, *_smoothed(angle, relative, sigma_ring)), level, sigma, radius)


def _smoothed(angle_rad: FloatArray, relative: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smoothing spline through radiances (n,) of known sigmas, and its one-sigma steps (n, k).

    How steep the profile is decides what light says of slopes, levels and places: a curve through each ring's noise is
    as steep as the noise is. How smooth the spline is follows from the smallest expected error by the data themselves
    (unbiased risk for known sigmas, Craven & Wahba 1979, section 1, doi 10.1007/BF01404567): a sharp limb leaves it
    nearly as measured. Its covariance includes what smoothing takes away (Wahba 1983, J. R. Stat. Soc. B 45, 133).
    """
    from scipy.interpolate import CubicSpline

    # An image without noise still has steps of light.
    sigma = np.maximum(sigma, 1e-6)
    flat, share = np.zeros(angle_rad.size), angle_rad / angle_rad[-1]
    bend = CubicSpline(share, np.eye(angle_rad.size), bc_type=((1, flat), (2, flat)))(share, 2)
    width = np.diff(share)[:, None]
    # The integral of the squared second derivative, which is a straight line between knots.
    first, last = bend[:-1], bend[1:]
    rough = (first.T @ (width * first) + last.T @ (width * last)) / 3
    rough += (first.T @ (width * last) + last.T @ (width * first)) / 6
    size, axes = np.linalg.eigh(sigma[:, None] * rough * sigma)
    size = np.maximum(size, 1e-12 * size[-1])
    seen = axes.T @ (relative / sigma)
    kept = 1.0 / (1.0 + np.geomspace(1e-2 / size[-1], 1e2 / size[0], 400)[:, None] * size)
    risk = (((1.0 - kept) * seen) ** 2).sum(axis=1) + 2 * kept.sum(axis=1)
    best = kept[np.argmin(risk)]
    steps = sigma[:, None] * axes * np.sqrt(best)
    return np.asarray(sigma * (axes @ (best * seen))), np.asarray(steps)


def _ring_variance(light: FloatArray, beside: FloatArray, ring: IntArray) -> FloatArray:
    """Return the variance of a pixel's light about a line across its ring, over five rings each, shape (rings,)."""
    count = np.bincount(ring)
    rest = light - (np.bincount(ring, light) / count)[ring]
    across = np.maximum(np.bincount(ring, beside**2), 1e-12)
    rest = rest - (np.bincount(ring, beside * rest) / across)[ring] * beside
    window = np.ones(5)
    squares = np.convolve(np.bincount(ring, rest**2), window, "same")
    return np.asarray(squares / np.convolve(np.maximum(count - 2, 0), window, "same"))


#: Sectors of the disc, and what one may differ from the others: limb darkening is the same all round.
_SECTORS, _UNEVEN = 12, 0.05


def _refuse_uneven(part: FloatArray, share: FloatArray, turn: FloatArray, what: str) -> None:
    """Refuse a disc of which one side is darker than the other: a cloud or a wire before it."""
    inside = np.isfinite(part) & (share > 0.3) & (share < 0.85)
    sector = ((turn[inside] / (2 * np.pi) + 0.5) * _SECTORS).astype(np.intp) % _SECTORS
    means = np.bincount(sector, part[inside], _SECTORS) / np.maximum(np.bincount(sector, minlength=_SECTORS), 1)
    spread = float(np.ptp(means) / means.mean())
    if spread > _UNEVEN:
        raise EstimationError(
            f"{what}: one side of the sun's disc is {100 * spread:.0f} % darker than the other: a cloud or something "
            "else is before it; take the image again"
        )
