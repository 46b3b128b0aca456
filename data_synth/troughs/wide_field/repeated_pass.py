"""One pass over a module, traced once, and modules of a field that differ in their targets."""

from copy import copy
from dataclasses import replace

import numpy as np

from data_synth.troughs.photo import Photographer
from data_synth.troughs.presets import TroughChoice, rim_targets, trough_scene
from data_synth.troughs.scene import TroughScene, TroughView
from heliogauge.errors import InputError
from heliogauge.validate import Float32Array, FloatArray

#: 1,861 codes of 16 bits, twelve for each module.
_DICTIONARY, _TARGETS, MOST_MODULES = "aicon-16", 12, 155
#: Distances between rows and between modules of one row, so that no photo shows two, and modules in a row [m].
_ROW_STEP_M, _MODULE_STEP_M, _IN_ROW = 17.0, 25.0, 10


class RepeatedPass(Photographer):
    """A pass over one module, whose light is traced once; further modules have their own targets in it."""

    #: Ten times what other photos have: a quarter of the time, and no pixel more than 1 DN other.
    sagitta_px = 5e-3

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


def place_of(number: int) -> FloatArray:
    """Return where a module stands in the frame of the field, shape (3,) [m]."""
    return np.array([_ROW_STEP_M * (number // _IN_ROW), _MODULE_STEP_M * (number % _IN_ROW), 0.0])
