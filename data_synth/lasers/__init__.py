"""Laser scans of a mirror with known slope errors, and of its surface."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.lasers.dataset import line_scene as line_scene
    from data_synth.lasers.dataset import write_laser_scan as write_laser_scan
    from data_synth.lasers.dataset import write_line_sweep as write_line_sweep
    from data_synth.lasers.dataset import write_surface_scan as write_surface_scan
    from data_synth.lasers.points import PointScene as PointScene
    from data_synth.lasers.scan import LaserScene as LaserScene

__getattr__, __dir__, __all__ = lazy_face(__name__)
