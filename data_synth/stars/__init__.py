"""Photos at night: stars in the facets of a heliostat."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.stars.dataset import write_stars as write_stars
    from data_synth.stars.night_scene import NightScene as NightScene

__getattr__, __dir__, __all__ = lazy_face(__name__)
