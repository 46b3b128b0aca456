"""Beams, sightings and photos of heliostats with known errors."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.heliostats.beam_photos import BenchOptions as BenchOptions
    from data_synth.heliostats.beam_photos import write_beam_dataset as write_beam_dataset
    from data_synth.heliostats.dataset import HeliostatOptions as HeliostatOptions
    from data_synth.heliostats.dataset import HeliostatTruth as HeliostatTruth
    from data_synth.heliostats.dataset import read_heliostat_truth as read_heliostat_truth
    from data_synth.heliostats.dataset import write_heliostat_dataset as write_heliostat_dataset
    from data_synth.heliostats.presets import HeliostatChoice as HeliostatChoice
    from data_synth.heliostats.presets import heliostat_scene as heliostat_scene

__getattr__, __dir__, __all__ = lazy_face(__name__)
