"""Metrology of solar mirrors: images in, slope maps with uncertainty out.

`measure` evaluates any folder with a measurement.toml, `measure_many` many of them side by side, `open` shows a folder
of results, `load` only reads and checks a measurement, `synth` makes one with known truth, and `report` builds
report.html. The packages of the instruments (deflectometry, photogrammetry, observer, calibration) have faces of their
own.
"""

# isort: off
from heliogauge.working_folder import forget_working_folder

# Before anything else is imported that a file of the same name could stand for.
forget_working_folder()

from typing import TYPE_CHECKING  # noqa: E402

from heliogauge.faces import lazy_face  # noqa: E402
# isort: on

if TYPE_CHECKING:
    from heliogauge.batch.measure import measure_many as measure_many
    from heliogauge.camera.model import Camera as Camera
    from heliogauge.doubts import Doubt as Doubt
    from heliogauge.geometry.rigid import RigidTransform as RigidTransform
    from heliogauge.measurement.load import load as load
    from heliogauge.results.opened import Result as Result
    from heliogauge.running.verbs import measure as measure
    from heliogauge.running.verbs import open as open  # noqa: A004
    from heliogauge.running.verbs import report as report
    from heliogauge.running.verbs import synth as synth
    from heliogauge.slopes.map import SlopeMap as SlopeMap

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_face(__name__)
