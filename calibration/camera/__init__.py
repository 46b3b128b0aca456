"""Camera calibration from photos of a board or of a field of coded targets.

Intrinsics, poses and the shape of the board come from one adjustment, with covariance.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.camera.boards import Chessboard as Chessboard
    from calibration.camera.corners.detection import BoardPoints as BoardPoints
    from calibration.camera.corners.detection import find_chessboard as find_chessboard
    from calibration.camera.judgement.comparison import compare as compare
    from calibration.camera.pipeline.measure import Options as Options
    from calibration.camera.pipeline.measure import run as run

__getattr__, __dir__, __all__ = lazy_face(__name__)
