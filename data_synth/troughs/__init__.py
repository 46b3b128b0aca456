"""Photos of parabolic troughs in which the absorber is seen, with known errors."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.troughs.dataset import TroughOptions as TroughOptions
    from data_synth.troughs.dataset import read_trough_truth as read_trough_truth
    from data_synth.troughs.dataset import write_trough_dataset as write_trough_dataset
    from data_synth.troughs.presets import TroughChoice as TroughChoice
    from data_synth.troughs.presets import trough_scene as trough_scene
    from data_synth.troughs.wide_field.dataset import write_wide_field as write_wide_field

__getattr__, __dir__, __all__ = lazy_face(__name__)
