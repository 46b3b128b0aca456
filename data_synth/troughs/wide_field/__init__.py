"""One flight over many modules: one pass is traced, each module has targets of its own in its light."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.troughs.wide_field.dataset import write_wide_field as write_wide_field

__getattr__, __dir__, __all__ = lazy_face(__name__)
