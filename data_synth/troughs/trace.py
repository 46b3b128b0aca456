"""What rays from a camera at a trough see: directly, through the glass, in the mirror."""

from copy import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from data_synth.troughs.mirror import MirrorTable, RayArray, Rays, TroughMirror
from data_synth.troughs.receiver import Passage, Receiver, ReceiverTable, ThrownBack
from data_synth.troughs.surroundings import Surroundings, SurroundingsTable
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: The mirror seen in itself more than once shows one tone.
_MOST_BOUNCES = 2
# Labels of what a ray meets; sky, ground and shadow are 0 to 2 (`SurroundingsTable.light`).
_GAP, _BACK, _ABSORBER, _GLASS, _SUPPORT, _ARM, _MIRROR = 3, 4, 5, 6, 7, 8, 16

Labels = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Finish:
    """Brightness of the collector's parts; paper has about 0.85.

    reflectance: Reflectance of the mirror.
    absorber, support, arm, gap, back: Brightness of the selective coating, of bellows and shields, of the steel
        arms, of what is seen between the panels, of the mirror's back.
    """

    reflectance: float = 0.93
    absorber: float = 0.045
    support: float = 0.34
    arm: float = 0.22
    gap: float = 0.10
    back: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class TroughWorld:
    """A trough and what is around it.

    mirror: The reflector with its errors.
    receiver: Absorber, glass, supports.
    surroundings: Sky and ground.
    finish: Brightness of the parts.
    """

    mirror: TroughMirror
    receiver: Receiver
    surroundings: Surroundings = field(default_factory=Surroundings)
    finish: Finish = field(default_factory=Finish)


class Seen(NamedTuple):
    """What rays see.

    light (n,): Light.
    label (n,): What it comes from, by which way; negative where a pixel must be looked at closely in any case.
    """

    light: Float32Array
    label: Labels


class Tracer:
    """A trough and its surroundings as rays meet them.

    world: What there is.
    dtype: Float type of the geometry; float64 is the reference in tests.
    """

    def __init__(self, world: TroughWorld, dtype: type[np.float32] | type[np.float64] = np.float32) -> None:
        self._finish = world.finish
        self.dtype = dtype
        self.mirror = MirrorTable(world.mirror, dtype)
        self.receiver = ReceiverTable(world.receiver, dtype)
        self.surroundings = SurroundingsTable(world.surroundings, self.mirror, dtype)

    def turned(self, surroundings: Surroundings) -> "Tracer":
        """Return the same trough, turned otherwise in the same surroundings.

        surroundings: The same surroundings but for the orientation.
        """
        tracer = copy(self)
        tracer.surroundings = self.surroundings.turned(surroundings)
        return tracer

    def look(self, rays: Rays) -> Seen:
        """Follow rays from the camera."""
        # Rays that meet nothing have no length; they drop out by comparisons with NaN and infinity.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            seen = self._look(rays, 0)
            outside = rays.x * rays.x > 4 * self.mirror.focal_length * rays.z
            if outside.any():
                back = self.mirror.meets_back(rays)
                seen.light[back], seen.label[back] = self._finish.back, _BACK
        return seen

    def hides(self, position_m: FloatArray, points_m: FloatArray) -> BoolArray:
        """Return which points the collector hides from a camera.

        Shapes: position_m (3,), points_m (n, 3).
        Returns (n,): Whether mirror or receiver stand in front of each.
        """
        # A hand's breadth short of the point, so that targets on the mirror do not hide themselves.
        distance = np.linalg.norm(points_m - position_m, axis=1)
        step = (points_m - position_m) * (1 - 0.05 / distance)[:, None]
        start, direction = np.broadcast_to(position_m, step.shape).T.astype(self.dtype), step.T.astype(self.dtype)
        rays = Rays(start[0], start[1], start[2], direction[0], direction[1], direction[2])
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            length = self.mirror.meet(rays)
            hidden = (length < 1) & self.mirror.within(rays.x + length * rays.dx, rays.y + length * rays.dy)
            hidden |= self.mirror.meets_back(rays, 1.0)
            passage = self.receiver.approach(rays)
            before = (passage.axis_z - rays.z[passage.which]) / rays.dz[passage.which]
        hidden[passage.which] |= (before > 0) & (before < 1)
        return np.asarray(hidden)

    def _look(self, rays: Rays, bounces: int) -> Seen:
        passage = self.receiver.approach(rays)
        if passage.which.size == 0:
            return self._below_tube(rays, bounces)
        n = rays.x.size
        seen = Seen(np.empty(n, dtype=np.float32), np.empty(n, dtype=np.int32))
        past = np.ones(n, dtype=np.bool_)
        past[passage.which] = False
        for index, part in (
            (passage.which, self._at_tube(passage, rays.take(passage.which), bounces)),
            (np.flatnonzero(past), self._below_tube(rays.take(np.flatnonzero(past)), bounces)),
        ):
            seen.light[index], seen.label[index] = part
        return seen

    def _below_tube(self, rays: Rays, bounces: int) -> Seen:
        """Follow rays that do not meet the tube."""
        seen = self._beyond(rays, bounces)
        arms = self.receiver.meet_arms(rays)
        seen.light[arms], seen.label[arms] = self._finish.arm, _ARM
        return seen

    def _beyond(self, rays: Rays, bounces: int) -> Seen:
        """Follow rays past the whole receiver."""
        mirror = self.mirror
        length = mirror.meet(rays)
        x, y = mirror.met_at(rays, length)
        hit = mirror.within(x, y)
        light, label = np.empty(hit.size, dtype=np.float32), np.empty(hit.size, dtype=np.int32)
        out = np.flatnonzero(~hit)
        if out.size:
            light[out], label[out] = self.surroundings.light(rays.take(out))
        on = np.flatnonzero(hit)
        if on.size:
            panel = mirror.panel(x[on], y[on])
            light[on], label[on] = self._in_mirror(rays.take(on), length[on], panel, bounces)
        return Seen(light, label)

    def _in_mirror(self, rays: Rays, length: RayArray, panel: npt.NDArray[np.int16], bounces: int) -> Seen:
        """Follow rays that meet the mirror: panels, -1 in gaps (n,)."""
        n = length.size
        if bounces >= _MOST_BOUNCES:
            tone = np.float32(self._finish.reflectance * 0.5)
            return Seen(np.full(n, tone, dtype=np.float32), np.full(n, _MIRROR, dtype=np.int32))
        light, label = np.full(n, self._finish.gap, dtype=np.float32), np.full(n, _GAP, dtype=np.int32)
        on = np.flatnonzero(panel >= 0)
        if on.size == 0:
            return Seen(light, label)
        panel = panel[on]
        reflected = _reflected(self.mirror, rays.take(on), length[on], panel)
        seen = self._look(reflected, bounces + 1)
        light[on] = seen.light * np.float32(self._finish.reflectance)
        # 15 bits of what is seen in the mirror, then the panel: across the narrowest gap the label changes.
        way = ((seen.label & 0x7FFF) << 5) + _MIRROR + (panel.astype(np.int32) << 20)
        label[on] = np.where(seen.label < 0, -1, way)
        return Seen(light, label)

    def _at_tube(self, passage: Passage, rays: Rays, bounces: int) -> Seen:
        receiver, finish = self.receiver, self._finish
        n = passage.which.size
        light, label = np.full(n, finish.support, dtype=np.float32), np.full(n, _SUPPORT, dtype=np.int32)
        side = passage.impact / receiver.support_radius
        light *= 0.45 + 0.55 * np.sqrt(np.maximum(1 - side * side, 0))
        open_ = np.flatnonzero(~receiver.on_support(passage))
        passage, rays = passage.take(open_), rays.take(open_)
        inside = receiver.enter(passage)
        part = np.empty(open_.size, dtype=np.float32)
        kind = np.full(open_.size, _ABSORBER, dtype=np.int32)
        on = inside.on_absorber
        round_ = np.sqrt(np.maximum(1 - inside.offset[on] ** 2, 0))
        part[on] = finish.absorber * (0.6 + 0.4 * round_)
        through = np.flatnonzero(~on)
        if through.size:
            leaving = receiver.leave(passage.take(through), inside.turned[through], rays.take(through))
            behind = self._beyond(leaving, bounces)
            part[through] = behind.light
            kind[through] = np.where(behind.label < 0, -1, behind.label * 16 + _GLASS)
        part *= inside.passed
        self._add_thrown_back(part, passage, inside.thrown_back, rays)
        light[open_], label[open_] = part, kind
        return Seen(light, label)

    def _add_thrown_back(
        self, light: Float32Array, passage: Passage, faces: tuple[ThrownBack, ...], rays: Rays
    ) -> None:
        """Add what the faces of the glass show by reflection: sky and ground, directly or by way of the mirror.

        In the mirror they show the absorber and the sky, without what its glass throws back a second time: 0.002 of
        the light.
        """
        for face in faces:
            on = np.flatnonzero(face.on_absorber)
            light[on] += face.share[on] * np.float32(self._finish.absorber)
            away = np.flatnonzero((face.share > 0) & ~face.on_absorber)
            if away.size == 0:
                continue
            back = self.receiver.leave(passage.take(away), face.turned[away], rays.take(away))
            length = self.mirror.meet(back)
            x, y = back.x + length * back.dx, back.y + length * back.dy
            in_mirror = self.mirror.within(x, y) & (self.mirror.panel(x, y) >= 0)
            share = face.share[away]
            tone = np.empty(away.size, dtype=np.float32)
            free = np.flatnonzero(~in_mirror)
            if free.size:
                tone[free] = self.surroundings.light(back.take(free))[0]
            by_mirror = np.flatnonzero(in_mirror)
            if by_mirror.size:
                tone[by_mirror] = self._shown_by_mirror(back.take(by_mirror), length[by_mirror])
            light[away] += share * np.minimum(tone, np.float32(30))

    def _shown_by_mirror(self, rays: Rays, length: RayArray) -> Float32Array:
        """Return the light of rays that meet panels: the absorber, or sky and ground."""
        panel = self.mirror.panel(rays.x + length * rays.dx, rays.y + length * rays.dy)
        once = _reflected(self.mirror, rays, length, panel)
        light = self.surroundings.light(once)[0]
        again = self.receiver.approach(once)
        light[again.which[self.receiver.enter(again).on_absorber]] = self._finish.absorber
        return np.asarray(light * np.float32(self._finish.reflectance))


def _reflected(mirror: MirrorTable, rays: Rays, length: RayArray, panel: npt.NDArray[np.int16]) -> Rays:
    """Return rays reflected at the true surface with its true normal."""
    x, y, z, slope_x, slope_y = mirror.surface(rays, length, panel)
    # The normal is (-slope_x, -slope_y, 1); rays come from above.
    against = 2 * (rays.dz - slope_x * rays.dx - slope_y * rays.dy) / (1 + slope_x * slope_x + slope_y * slope_y)
    return Rays(x, y, z, rays.dx + against * slope_x, rays.dy + against * slope_y, rays.dz - against)
