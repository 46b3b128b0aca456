"""Photos of a heliostat whose facets show a bright source."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.reflections.dataset import write_overlay as write_overlay
    from data_synth.reflections.scene import ReflectionScene as ReflectionScene

__getattr__, __dir__, __all__ = lazy_face(__name__)
