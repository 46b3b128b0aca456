"""Several troughs in one frame, as a flight over a field sees them."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data_synth.optics.sheets import Sheet
from data_synth.troughs.mirror import RayArray, Rays
from data_synth.troughs.scene import ListedTarget, PlacedTrough, TroughScene, TroughView
from data_synth.troughs.surroundings import Surroundings
from data_synth.troughs.trace import Seen, Tracer
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray

#: A ray belongs to the trough nearest to it at this height, half of what a trough reaches to [m].
_HALF_HEIGHT_M = 0.8
#: Labels of one trough end below: they keep rays of different troughs apart, by which edges of pixels are found.
_LABELS = 1 << 26


class FieldTracer:
    """Several troughs as rays meet them, each alone in its part of the field.

    dtype: Float type of the geometry.

    A ray is followed in the frame of the trough whose footprint is nearest to it half-way up. That is right for rays
    that meet a trough while troughs stand further apart than what is seen over their rims from above: 1.5 m for rays
    of 45 degrees. What one trough's mirror shows of the others is left out.
    """

    def __init__(self, troughs: tuple[PlacedTrough, ...], dtype: type[np.float32] | type[np.float64]) -> None:
        self._troughs = troughs
        self._dtype = dtype
        self._tracers = tuple(Tracer(one.world, dtype) for one in troughs)

    def turned(self, surroundings: Surroundings) -> "FieldTracer":
        """Return the same field under the same sky; every trough keeps its orientation."""
        if surroundings.orientation_deg != self._troughs[0].world.surroundings.orientation_deg:
            raise InputError("field: its troughs do not turn from photo to photo")
        return copy(self)

    def look(self, rays: Rays) -> Seen:
        """Follow rays from the camera, as `data_synth.troughs.trace.Tracer.look`."""
        with np.errstate(invalid="ignore", divide="ignore"):
            length = (self._dtype(_HALF_HEIGHT_M) - rays.z) / rays.dz
            nearest = self._nearest(rays.x + length * rays.dx, rays.y + length * rays.dy)
        seen = Seen(np.empty(rays.x.size, dtype=np.float32), np.empty(rays.x.size, dtype=np.int32))
        for number, (one, tracer) in enumerate(zip(self._troughs, self._tracers, strict=True)):
            index = np.flatnonzero(nearest == number)
            if index.size == 0:
                continue
            part = tracer.look(_shifted(rays.take(index), one.place_m, self._dtype))
            seen.light[index] = part.light
            seen.label[index] = np.where(part.label < 3, part.label, part.label + number * _LABELS)
        return seen

    def hides(self, position_m: FloatArray, points_m: FloatArray) -> BoolArray:
        """Return which points the troughs hide from a camera, as `data_synth.troughs.trace.Tracer.hides`."""
        hidden = np.zeros(len(points_m), dtype=bool)
        for one, tracer in zip(self._troughs, self._tracers, strict=True):
            hidden |= tracer.hides(position_m - one.place_m, points_m - one.place_m)
        return hidden

    def _nearest(self, x: RayArray, y: RayArray) -> RayArray:
        """Return the number of the trough whose footprint is nearest to points, shape (n,)."""
        away = []
        for one in self._troughs:
            design = one.world.mirror.collector
            across = np.abs(x - self._dtype(one.place_m[0])) - self._dtype(design.aperture_width_m / 2)
            along = np.abs(y - self._dtype(one.place_m[1])) - self._dtype(design.length_m / 2)
            away.append(np.maximum(across, 0) ** 2 + np.maximum(along, 0) ** 2)
        return np.asarray(np.argmin(np.nan_to_num(np.stack(away), nan=np.inf), axis=0))


def _shifted(rays: Rays, place_m: FloatArray, dtype: type[np.float32] | type[np.float64]) -> Rays:
    x, y, z = (dtype(value) for value in place_m)
    return rays._replace(x=rays.x - x, y=rays.y - y, z=rays.z - z)


class NeighbourScene(NamedTuple):
    """A single trough of a field: its name, place in the common frame [m] and scene."""

    name: str
    place_m: FloatArray
    scene: TroughScene


def field_of(name: str, scenes: Sequence[NeighbourScene], views: tuple[TroughView, ...]) -> TroughScene:
    """Put scenes of single troughs side by side.

    scenes: The troughs; photos of their own are left out.
    views: Photos in the common frame.
    Returns: One scene; its list of targets is in the common frame.
    InputError: Two troughs use the same target.
    """
    sheets: list[Sheet] = []
    targets: list[ListedTarget] = []
    for _, place, scene in scenes:
        shift = RigidTransform(np.eye(3), place)
        sheets += [replace(one, world_from_sheet=shift @ one.world_from_sheet) for one in scene.sheets]
        targets += [replace(one, stated_m=one.stated_m + place) for one in scene.targets]
    names = [one.name for one in targets]
    if len(set(names)) < len(names):
        raise InputError(f"scene {name}: a target stands at two troughs")
    troughs = tuple(PlacedTrough(label, scene.world, place) for label, place, scene in scenes)
    first = scenes[0].scene
    return replace(first, name=name, views=views, sheets=tuple(sheets), targets=tuple(targets), troughs=troughs)


def single_of(scene: TroughScene, trough: PlacedTrough) -> TroughScene:
    """Return one trough of a field as a scene of its own.

    Returns: All photos and targets in the trough's own frame.
    """
    shift = RigidTransform(np.eye(3), trough.place_m)
    views = tuple(replace(view, cam_from_trough=view.cam_from_trough @ shift) for view in scene.views)
    sheets = tuple(replace(one, world_from_sheet=shift.inverse() @ one.world_from_sheet) for one in scene.sheets)
    targets = tuple(replace(one, stated_m=one.stated_m - trough.place_m) for one in scene.targets)
    return replace(scene, name=trough.name, world=trough.world, views=views, sheets=sheets, targets=targets, troughs=())
