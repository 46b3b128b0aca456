"""Targets and markers found in photos and identified; false codes refused with a reason.

`measure_targets` finds, reads and centres all circular targets of a photo by a `TargetSearch`, `measure_at` those
whose places are known, `find_markers` square markers, all as `Detections`; `board_corners` the corners of boards.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.detection import board_corners as board_corners
    from photogrammetry.detection.detect import SearchLimits as SearchLimits
    from photogrammetry.detection.detect import find_candidates as find_candidates
    from photogrammetry.detection.detect import find_outlines as find_outlines
    from photogrammetry.detection.detections import Detections as Detections
    from photogrammetry.detection.markers import find_markers as find_markers
    from photogrammetry.detection.photo_targets import TargetSearch as TargetSearch
    from photogrammetry.detection.photo_targets import measure_at as measure_at
    from photogrammetry.detection.photo_targets import measure_targets as measure_targets

__getattr__, __dir__, __all__ = lazy_face(__name__)
