"""Photos of coded targets and calibration boards at known places."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.targets.boards import board_scene as board_scene
    from data_synth.targets.boards import board_table as board_table
    from data_synth.targets.code_wall import PRINT_KINDS as PRINT_KINDS
    from data_synth.targets.code_wall import wall_scenes as wall_scenes
    from data_synth.targets.dataset import PhotoOptions as PhotoOptions
    from data_synth.targets.dataset import camera_content as camera_content
    from data_synth.targets.dataset import write_target_dataset as write_target_dataset
    from data_synth.targets.isolated_target import IsolatedTarget as IsolatedTarget
    from data_synth.targets.isolated_target import draw_isolated as draw_isolated
    from data_synth.targets.presets import target_scene as target_scene
    from data_synth.targets.scene import image_truth as image_truth
    from data_synth.targets.scene import render_photo as render_photo

__getattr__, __dir__, __all__ = lazy_face(__name__)
