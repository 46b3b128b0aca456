"""Photos of a bent display or a field of dots with markers at its rims, and of a measuring camera in its place."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.screens.dataset import write_screen_dataset as write_screen_dataset
    from data_synth.screens.scene import ScreenChoice as ScreenChoice
    from data_synth.screens.scene import screen_scene as screen_scene

__getattr__, __dir__, __all__ = lazy_face(__name__)
