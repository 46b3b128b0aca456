"""Fringe images of mirrors with known errors: scenes, photos, what the person who measures knows, truth."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.fringes.dataset import DatasetOptions as DatasetOptions
    from data_synth.fringes.dataset import read_truth as read_truth
    from data_synth.fringes.dataset import write_dataset as write_dataset
    from data_synth.fringes.dataset import write_gray_code as write_gray_code
    from data_synth.fringes.knowledge import Knowledge as Knowledge
    from data_synth.fringes.knowledge import measurement_content as measurement_content
    from data_synth.fringes.knowledge import response_table as response_table
    from data_synth.fringes.knowledge import screen_table as screen_table
    from data_synth.fringes.presets import preset_scene as preset_scene
    from data_synth.fringes.scene import FringeScene as FringeScene
    from data_synth.fringes.scene import expected_light as expected_light
    from data_synth.fringes.scene import render_fringes as render_fringes

__getattr__, __dir__, __all__ = lazy_face(__name__)
