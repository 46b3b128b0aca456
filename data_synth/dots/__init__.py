"""Photos of fields of dots seen in mirrors with known errors: scene, photo, measurement folder."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.dots.dataset import wind_turns as wind_turns
    from data_synth.dots.dataset import write_dot_dataset as write_dot_dataset
    from data_synth.dots.dataset import write_dot_series as write_dot_series
    from data_synth.dots.photo import DotScene as DotScene
    from data_synth.dots.photo import dot_scene as dot_scene
    from data_synth.dots.photo import photo_light as photo_light
    from data_synth.dots.photo import place_dots as place_dots

__getattr__, __dir__, __all__ = lazy_face(__name__)
