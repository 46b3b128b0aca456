"""Heliostats of facets with known tilts under sun and stars, and cameras that look at them."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.sky.dataset import gazing_preset as gazing_preset
    from data_synth.sky.dataset import write_gazing as write_gazing
    from data_synth.sky.gazing_scene import GazingScene as GazingScene

__getattr__, __dir__, __all__ = lazy_face(__name__)
