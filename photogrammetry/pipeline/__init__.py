"""The stages of a photogrammetric measurement, in a row in `run`; and those that other instruments start with.

`build_cameras`, `build_search` and `build_constraints` turn what measurement.toml says into values,
`measure_photo` and `collect_photos` turn photos into image points; `find_faults` says what is wrong before that.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.pipeline.cameras import build_cameras as build_cameras
    from photogrammetry.pipeline.check import find_faults as find_faults
    from photogrammetry.pipeline.inputs import build_constraints as build_constraints
    from photogrammetry.pipeline.inputs import build_search as build_search
    from photogrammetry.pipeline.measure import Options as Options
    from photogrammetry.pipeline.measure import run as run
    from photogrammetry.pipeline.photos import MeasuredPhotos as MeasuredPhotos
    from photogrammetry.pipeline.photos import OnePhoto as OnePhoto
    from photogrammetry.pipeline.photos import collect_photos as collect_photos
    from photogrammetry.pipeline.photos import measure_photo as measure_photo
    from photogrammetry.pipeline.positions import read_drone_positions as read_drone_positions
    from photogrammetry.pipeline.result import Result as Result

__getattr__, __dir__, __all__ = lazy_face(__name__)
