"""Synthetic measurements with known truth: what draws (optics) and one room for each kind of scene."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth import fringes as fringes
    from data_synth import heliostats as heliostats
    from data_synth import optics as optics
    from data_synth import targets as targets
    from data_synth import troughs as troughs

__getattr__, __dir__, __all__ = lazy_face(__name__)
