"""Tests of a heliostat with known truth: beams over days, play, wind, reflectance, controller, energy."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.acceptance.dataset import write_tests_folder as write_tests_folder
    from data_synth.acceptance.plant import TestPlant as TestPlant

__getattr__, __dir__, __all__ = lazy_face(__name__)
