"""One flight over many modules, drawn in minutes: one pass is traced; each has its own targets in that light."""

from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_ARRAYS_FILE, TRUTH_FILE
from data_synth.troughs.dataset import TroughOptions, trough_to_json, truth_arrays, write_knowledge, write_photo
from data_synth.troughs.field import NeighbourScene, field_of
from data_synth.troughs.photo import Photographer
from data_synth.troughs.presets import TroughChoice, rim_targets, trough_scene
from data_synth.troughs.scene import TroughScene, TroughView
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.json_file import write_json
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import Float32Array, FloatArray

#: 1,861 codes of 16 bits, twelve for each module.
_DICTIONARY, _TARGETS, MOST_MODULES = "aicon-16", 12, 155
#: Distances between rows and between modules of one row, so that no photo shows two, and modules in a row [m].
_ROW_STEP_M, _MODULE_STEP_M, _IN_ROW = 17.0, 25.0, 10


class RepeatedPass(Photographer):
    """A pass over one module, whose light is traced once; further modules have their own targets in it."""

    def __init__(self, scene: TroughScene) -> None:
        super().__init__(scene)
        traced, rngs = super().light, np.random.default_rng(0).spawn(len(scene.views))
        self._traced = {view.name: traced(view, rng) for view, rng in zip(scene.views, rngs, strict=True)}

    def light(self, view: TroughView, rng: np.random.Generator) -> Float32Array:
        """Return the light that was traced."""
        return self._traced[view.name].copy()

    def over(self, scene: TroughScene) -> "RepeatedPass":
        """Return the same pass over a module that differs in its targets only."""
        other = copy(self)
        other._scene = scene
        return other


def module_scenes(modules: int, photos: int) -> list[TroughScene]:
    """Return the scenes of modules, each in its own frame: the preset ``small``, targets by targets of their own.

    photos: Photos of each.
    InputError: More modules than there are codes.
    """
    if modules > MOST_MODULES:
        raise InputError(f"modules: at most {MOST_MODULES}, not {modules}; each has {_TARGETS} codes of {_DICTIONARY}")
    scene = trough_scene("small", TroughChoice(n_photos=photos, dictionary=_DICTIONARY))
    found = []
    for number in range(modules):
        rng, first = np.random.default_rng([number, 11]), _TARGETS * number
        sheets, targets = rim_targets(
            scene.world.mirror.collector, _DICTIONARY, scene.target_diameter_m, rng, n=_TARGETS, first=first
        )
        found.append(replace(scene, sheets=sheets, targets=targets))
    return found


def write_wide_field(folder: Path, modules: int, photos: int, progress: Progress | None = None) -> None:
    """Write one flight over many modules as a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    modules: Their number.
    photos: Photos of each.
    InputError: The folder holds something, cannot be written to, or there are too few codes.

    Mirrors and cameras' paths are alike, so that one pass is traced for all of them; targets, their places and the
    noise of each photo are not. No photo shows two modules.
    """
    progress, options = progress or SilentProgress(), TroughOptions(jpeg_quality=95)
    scenes = module_scenes(modules, photos)
    with WholeFolder(folder, SYNTHETIC) as working:
        with progress.stage("trace one pass"):
            above = RepeatedPass(scenes[0])
        rows, views = [], []
        with progress.stage("draw targets", modules) as stage:
            for number, scene in enumerate(scenes):
                camera, rng, place = above.over(scene), np.random.default_rng([number, 12]), _place_of(number)
                for view in scene.views:
                    name = f"photo_{number:03}_{view.name.removeprefix('photo_')}"
                    write_photo(working / f"{name}.jpg", camera.take(view, rng), options.jpeg_quality)
                    pose = view.cam_from_trough @ RigidTransform(np.eye(3), -place)
                    views.append(replace(view, name=name, cam_from_trough=pose))
                rows.append(NeighbourScene(f"module-{number:03}", place, scene))
                stage.advance()
        with progress.stage("write truth"):
            whole = field_of("a wide field", rows, tuple(views))
            write_knowledge(working, whole, ".jpg", options)
            write_json(working / TRUTH_FILE, {**trough_to_json(whole, ".jpg"), "seed": options.seed})
            np.savez_compressed(working / TRUTH_ARRAYS_FILE, allow_pickle=False, **truth_arrays(whole))


def _place_of(number: int) -> FloatArray:
    return np.array([_ROW_STEP_M * (number // _IN_ROW), _MODULE_STEP_M * (number % _IN_ROW), 0.0])
