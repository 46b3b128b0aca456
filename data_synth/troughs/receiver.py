"""The receiver of a trough: absorber tube on any smooth curve, glass around it with refraction, supports."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from data_synth.troughs.mirror import RayArray, Rays
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array
from observer.trough import Collector

#: Points of the table that rays use: joined by straight lines, a sag of 10 mm over 4 m is right within 10 nm.
_TABLE_POINTS = 4001
#: Supports hide this many glass (or bare tube) diameters.
_SUPPORT_FACTOR = 1.15
_ARM_HALF_WIDTH_M = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class TubeAxis:
    """Where the middle of a tube is, as offsets from the design's focal line, joined by a cubic spline.

    y_m (n,): Ascending positions along the trough, at least 4 [m].
    x_m, z_m (n,): Offsets from the focal line across and along the optical axis [m].
    """

    y_m: FloatArray
    x_m: FloatArray
    z_m: FloatArray

    def __post_init__(self) -> None:
        for name in ("y_m", "x_m", "z_m"):
            object.__setattr__(self, name, float_array(f"axis {name}", getattr(self, name), (None,)))
        if not self.y_m.size == self.x_m.size == self.z_m.size >= 4 or np.any(np.diff(self.y_m) <= 0):
            raise InputError("axis: y_m, x_m, z_m of equal length are needed, at least 4, y_m ascending")
        largest = max(float(np.abs(self.x_m).max()), float(np.abs(self.z_m).max()))
        if largest > 0.5:
            raise InputError(f"axis: {largest:g} m beside the focal line; are the units right (offsets in metres)?")

    @classmethod
    def straight(
        cls, x_m: float = 0.0, z_m: float = 0.0, slope_x: float = 0.0, slope_z: float = 0.0, reach_m: float = 10.0
    ) -> "TubeAxis":
        """Return a straight tube.

        x_m, z_m: Offsets from the focal line at y = 0 [m].
        slope_x, slope_z: Their change with y.
        reach_m: How far along y the axis is described, in both directions [m].
        """
        y = np.linspace(-reach_m, reach_m, 4)
        return cls(y, x_m + slope_x * y, z_m + slope_z * y)

    def sagging(self, supports_m: npt.ArrayLike, sag_x_m: float, sag_z_m: float) -> "TubeAxis":
        """Return the axis with a sag between supports that is horizontal at each of them.

        supports_m (n,): Where the tube is held, ascending [m].
        sag_x_m, sag_z_m: Offset in the middle of each span; gravity at zenith makes the second one negative [m].
        Returns: The axis over the same range.
        """
        supports = float_array("supports_m", supports_m, (None,))
        y = np.linspace(self.y_m[0], self.y_m[-1], 801)
        span = np.interp(y, supports, np.arange(supports.size, dtype=np.float64))
        # A beam clamped at both ends under its own weight: w = 16 u^2 (1 - u)^2 of its middle.
        u = span % 1.0
        shape = 16 * (u * (1 - u)) ** 2
        x, z = self.offsets_m(y)
        return TubeAxis(y, x + sag_x_m * shape, z + sag_z_m * shape)

    def offsets_m(self, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the offsets from the focal line across and along the optical axis.

        y_m (...): Positions along the trough [m].
        Returns (...): x and z offsets [m].
        """
        from scipy.interpolate import CubicSpline

        y = np.clip(y_m, self.y_m[0], self.y_m[-1])
        x, z = (np.asarray(CubicSpline(self.y_m, values)(y)) for values in (self.x_m, self.z_m))
        return x, z


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """The receiver of a collector.

    collector: Diameters, glass, supports.
    absorber: Where the absorber is; on the focal line without.
    glass: Where the glass is; None: around the absorber.
    has_arms: Whether arms carry the supports from the vertex.
    """

    collector: Collector
    absorber: TubeAxis = field(default_factory=TubeAxis.straight)
    glass: TubeAxis | None = None
    has_arms: bool = True

    def __post_init__(self) -> None:
        tube = self.collector.glass
        if tube is None or self.glass is None:
            return
        y = np.linspace(-self.collector.length_m / 2, self.collector.length_m / 2, 101)
        apart = np.hypot(*np.subtract(self.absorber.offsets_m(y), self.glass.offsets_m(y)))
        room = (tube.inner_diameter_m - self.collector.absorber_diameter_m) / 2
        if apart.max() >= room:
            raise InputError(f"receiver: the absorber, {1e3 * apart.max():.1f} mm off, touches the glass")

    def position_m(self, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return X and Z of the absorber's middle in the trough's frame, shape (...) [m]."""
        x, z = self.absorber.offsets_m(y_m)
        return x, z + self.collector.focal_length_m


class Passage(NamedTuple):
    """Rays at a tube, in the plane across it.

    which (n,): The rays that come near the tube.
    y (n,): Where along the tube they are nearest to the axis [m].
    impact (n,): How far they pass to the right of the axis, seen along the ray with y pointing at the viewer's back
        [m].
    ux, uz (n,): Unit direction across.
    axis_x, axis_z (n,): The axis there [m].
    sin_along (n,): Sine of the angle between ray and transverse plane.
    """

    which: IntArray
    y: RayArray
    impact: RayArray
    ux: RayArray
    uz: RayArray
    axis_x: RayArray
    axis_z: RayArray
    sin_along: RayArray

    def take(self, index: IntArray) -> "Passage":
        """Return some of the rays."""
        return Passage(*(part[index] for part in self._arrays()))

    def _arrays(self) -> tuple[RayArray, ...]:
        return tuple(self)


class ThrownBack(NamedTuple):
    """Light that one face of the glass adds, from where a ray goes that it reflects.

    share (n,): Share of that light which comes to the viewer.
    turned (n,): Angle by which the ray leaves the glass turned, towards the side on which it passes the axis [rad].
    on_absorber (n,): Whether it ends on the absorber instead of leaving.
    """

    share: RayArray
    turned: RayArray
    on_absorber: BoolArray


class Inside(NamedTuple):
    """Rays of a `Passage` that reach the glass or the bare absorber.

    on_absorber (n,): Whether they end on the absorber.
    offset (n,): How far beside the absorber's middle they hit it, in radii.
    turned (n,): Angle by which those that pass leave the glass turned, towards the side on which they pass the axis
        [rad].
    passed (n,): Share of the light that comes to the viewer from where they end.
    thrown_back: What is reflected once: at both faces of the near wall and, unless the absorber is before it, of the
        far one. What is reflected twice is left out: six pairs of faces, beside the absorber 0.01 of the light.
    """

    on_absorber: BoolArray
    offset: RayArray
    turned: RayArray
    passed: RayArray
    thrown_back: tuple[ThrownBack, ...] = ()


class ReceiverTable:
    """The receiver as rays meet it.

    dtype: Float type of the rays.

    Seen across, a ray of a tube that runs along y obeys the plane law of refraction with the index
    ``sqrt(n^2 - sin(g)^2) / cos(g)``, g its angle to the transverse plane. Around a concentric tube the impact
    parameter is conserved (Bouguer), so only the direction changes: towards the axis at the outer face, away from it
    at the inner. Slopes of the axes (a few mrad) are taken to first order: the direction is sheared along.
    """

    def __init__(self, receiver: Receiver, dtype: type[np.float32] | type[np.float64] = np.float32) -> None:
        design = receiver.collector
        self._dtype = dtype
        self._focal = dtype(design.focal_length_m)
        self._half_length = dtype(design.length_m / 2)
        self._radius = dtype(design.absorber_diameter_m / 2)
        self._glass = design.glass
        self.outer_radius = dtype((design.glass.outer_diameter_m if design.glass else design.absorber_diameter_m) / 2)
        self.support_radius = dtype(_SUPPORT_FACTOR) * self.outer_radius
        self._supports = design.support_y_m.astype(dtype)
        self._half_support = dtype(design.support_width_m / 2)
        self._arm_top = self._focal - self.outer_radius
        self._has_arms = receiver.has_arms and len(design.support_y_m) > 0
        y = np.linspace(-design.length_m / 2, design.length_m / 2, _TABLE_POINTS)
        absorber = np.stack(receiver.absorber.offsets_m(y))
        around = receiver.glass if design.glass is not None and receiver.glass is not None else receiver.absorber
        outer = np.stack(around.offsets_m(y))
        self._first, self._per_m = dtype(y[0]), dtype((y.size - 1) / (y[-1] - y[0]))
        self._outer = np.concatenate([outer, np.gradient(outer, y, axis=1)]).astype(dtype)
        self._between = (absorber - outer).astype(dtype)
        self._margin = dtype(np.abs(outer).max() + 1e-3)

    def approach(self, rays: Rays) -> Passage:
        """Find the rays that meet the tube or its supports ahead."""
        x, z = rays.x, rays.z - self._focal
        square = rays.dx * rays.dx + rays.dz * rays.dz
        cross = x * rays.dz - z * rays.dx
        ahead = -(x * rays.dx + z * rays.dz)
        reach = (self.support_radius + self._margin) ** 2
        index = np.flatnonzero((cross * cross < reach * square) & (ahead > 0))
        ray = rays.take(index)
        length = ahead[index] / square[index]
        y = ray.y + length * ray.dy
        axis_x, axis_z, slope_x, slope_z = self._at(self._outer, y)
        ux, uz = ray.dx - slope_x * ray.dy, ray.dz - slope_z * ray.dy
        # Relative to the axis at y; the sheared ray keeps its distance while y moves on to the nearest point.
        from_x = ray.x + length * ray.dx - axis_x
        from_z = ray.z + length * ray.dz - self._focal - axis_z
        size = np.sqrt(ux * ux + uz * uz)
        ux, uz = ux / size, uz / size
        impact = from_x * uz - from_z * ux
        further = -(from_x * ux + from_z * uz) / size
        moved = further * ray.dy
        sin_along = ray.dy / np.sqrt(size * size + ray.dy * ray.dy)
        passage = Passage(
            index,
            y + moved,
            impact,
            ux,
            uz,
            axis_x + slope_x * moved,
            self._focal + axis_z + slope_z * moved,
            sin_along,
        )
        touches = np.abs(impact) < np.where(self.on_support(passage), self.support_radius, self.outer_radius)
        touches &= np.abs(passage.y) < self._half_length
        return passage.take(np.flatnonzero(touches))

    def on_support(self, passage: Passage) -> BoolArray:
        """Return where along the tube supports with their bellows hide it, shape (n,)."""
        hidden: BoolArray = np.zeros(passage.y.size, dtype=np.bool_)
        for support in self._supports:
            hidden |= np.abs(passage.y - support) < self._half_support
        return hidden

    def enter(self, passage: Passage) -> Inside:
        """Follow rays into the glass.

        passage: Rays that touch the outer face.
        Returns: Whether they end on the absorber, and how they leave.
        """
        b = passage.impact
        between_x, between_z = self._at(self._between, passage.y)
        if self._glass is None:
            hit = np.abs(b) < self._radius
            return Inside(hit, b / self._radius, np.zeros_like(b), np.ones_like(b))
        cos_square = 1 - passage.sin_along**2
        index = np.sqrt((self._dtype(self._glass.index**2) - passage.sin_along**2) / cos_square)
        outer, inner = (b / self._dtype(d / 2) for d in (self._glass.outer_diameter_m, self._glass.inner_diameter_m))
        out_angle, out_inside = np.arcsin(np.clip(outer, -1, 1)), np.arcsin(outer / index)
        in_angle, in_inside = np.arcsin(np.clip(inner, -1, 1)), np.arcsin(np.clip(inner / index, -1, 1))
        at_outer, at_inner = out_angle - out_inside, in_angle - in_inside
        inward = at_inner - at_outer
        half = np.copysign(self._dtype(np.pi), b)
        # Beyond the inner face's edge the light is thrown back within the wall and leaves through the outer face.
        wall = np.abs(inner) >= 1
        bounce = half - 2 * in_inside - 2 * at_outer

        def hits(turned: RayArray) -> RayArray:
            """Return how far beside the absorber's middle rays pass that are turned, in radii."""
            # The direction is turned towards w = (uz, -ux), and so is w.
            wx = passage.uz * np.cos(turned) - passage.ux * np.sin(turned)
            wz = -passage.ux * np.cos(turned) - passage.uz * np.sin(turned)
            return np.asarray((b - between_x * wx - between_z * wz) / self._radius)

        offset = hits(inward)
        on_absorber = (np.abs(offset) < 1) & ~wall
        lost_out, lost_in = (
            _fresnel(cos_square * np.cos(angle) ** 2, self._glass.index) for angle in (out_angle, in_angle)
        )
        first = np.square(1 - lost_out)
        near = first * np.square(1 - lost_in)
        passed = np.where(wall, first, np.where(on_absorber, (1 - lost_out) * (1 - lost_in), near))
        never = np.zeros(b.size, dtype=np.bool_)
        back = [ThrownBack(lost_out, half - 2 * out_angle, never)]
        back.append(ThrownBack(np.where(wall, 0, first * lost_in), bounce, never))
        # What has passed the absorber is reflected by the far wall, towards the axis, and passes it once more.
        far = np.where(wall | on_absorber, 0, near)
        once = np.maximum((1 - lost_out) * (1 - lost_in), self._dtype(1e-3))
        for share, turned in (
            (far * lost_in, inward - half + 2 * in_angle),
            (far * np.square(1 - lost_in) * lost_out, inward + 2 * at_inner - half + 2 * out_inside),
        ):
            ends = np.abs(hits(turned)) < 1
            back.append(ThrownBack(np.where(ends, share / once, share), turned + inward, ends))
        return Inside(on_absorber, offset, np.where(wall, bounce, 2 * inward), passed, tuple(back))

    def leave(self, passage: Passage, turned: RayArray, rays: Rays) -> Rays:
        """Return rays behind the tube, turned about it.

        turned (n,): Angle towards the side on which they pass [rad].
        rays: The same rays before the tube, shape (n,).
        Returns: They start beside the axis.
        """
        cos, sin = np.cos(turned), np.sin(turned)
        ux, uz = passage.ux * cos + passage.uz * sin, passage.uz * cos - passage.ux * sin
        across = np.sqrt(rays.dx * rays.dx + rays.dz * rays.dz)
        x, z = passage.axis_x + passage.impact * uz, passage.axis_z - passage.impact * ux
        return Rays(x, passage.y, z, ux * across, rays.dy, uz * across)

    def meet_arms(self, rays: Rays) -> IntArray:
        """Return which rays end on the arms between the vertex and the supports."""
        if not self._has_arms:
            return np.zeros(0, dtype=np.intp)
        half, top = self._dtype(_ARM_HALF_WIDTH_M), self._arm_top
        slope = rays.dx / rays.dz
        low = rays.x - rays.z * slope
        high = low + top * slope
        index = np.flatnonzero((np.minimum(low, high) < half) & (np.maximum(low, high) > -half))
        ray = rays.take(index)
        start, end = np.zeros_like(ray.x), np.full_like(ray.x, np.inf)
        for place, step, limits in ((ray.x, ray.dx, (-half, half)), (ray.z, ray.dz, (0 * top, top))):
            first, last = (limits[0] - place) / step, (limits[1] - place) / step
            start = np.maximum(start, np.minimum(first, last))
            end = np.minimum(end, np.maximum(first, last))
        hit = np.zeros(index.size, dtype=np.bool_)
        for support in self._supports:
            # At the module's ends the arms stand within it.
            middle = np.clip(support, -self._half_length + half, self._half_length - half)
            first, last = (middle - half - ray.y) / ray.dy, (middle + half - ray.y) / ray.dy
            hit |= np.maximum(start, np.minimum(first, last)) < np.minimum(end, np.maximum(first, last))
        return index[hit]

    def _at(self, table: RayArray, y: RayArray) -> list[RayArray]:
        """Return each row of a table at positions along the tube."""
        place = np.clip((y - self._first) * self._per_m, 0, _TABLE_POINTS - 1.001)
        before = place.astype(np.intp)
        share = place - before.astype(place.dtype)
        low, high = table[:, before], table[:, before + 1]
        return list(low + (high - low) * share)


def _fresnel(cos_square: RayArray, index: float) -> RayArray:
    """Return the share of unpolarised light that a face of glass reflects; squared cosine of the angle in air."""
    cosine, behind = np.sqrt(cos_square), np.sqrt(index * index - 1 + cos_square)
    across, along = (
        (cosine - behind) / (cosine + behind),
        (index * index * cosine - behind) / (index * index * cosine + behind),
    )
    return np.asarray((across * across + along * along) / 2)
