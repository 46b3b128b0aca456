"""What the measurement.toml of a photo network may say, section by section.

Other instruments that measure a photo network take the same sections into their own files.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.keys.cameras import CameraSections as CameraSections
    from photogrammetry.keys.cameras import NetworkCameraSection as NetworkCameraSection
    from photogrammetry.keys.load import PhotogrammetryMeasurement as PhotogrammetryMeasurement
    from photogrammetry.keys.measurement import CoordinateSection as CoordinateSection
    from photogrammetry.keys.measurement import DatumSection as DatumSection
    from photogrammetry.keys.measurement import DistanceSection as DistanceSection
    from photogrammetry.keys.measurement import PhotogrammetryModel as PhotogrammetryModel
    from photogrammetry.keys.measurement import ScaleBarSection as ScaleBarSection
    from photogrammetry.keys.natural import NaturalSection as NaturalSection
    from photogrammetry.keys.positions import PositionsSection as PositionsSection
    from photogrammetry.keys.targets import TargetsSection as TargetsSection
    from photogrammetry.keys.targets import UncodedSection as UncodedSection

__getattr__, __dir__, __all__ = lazy_face(__name__)
