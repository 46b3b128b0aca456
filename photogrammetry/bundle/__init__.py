"""The bundle adjustment: poses, points and cameras with joint covariance, datum and diagnosis.

`adjust` solves a `BundleProblem` from a `BundleState`; its `BundleResult` names what is not determined. Beside it stand
`constraints` (distances, coordinates, planes), `alignment` of start values to them, `datum` (movements that no image
point sees), `state` (intrinsics as they are varied), `statistics` (tests, rejection, correlations) and `eccentricity`
(the centre of a circle's image).
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.bundle import alignment as alignment
    from photogrammetry.bundle import constraints as constraints
    from photogrammetry.bundle import datum as datum
    from photogrammetry.bundle import eccentricity as eccentricity
    from photogrammetry.bundle import state as state
    from photogrammetry.bundle import statistics as statistics
    from photogrammetry.bundle.adjustment import BundleResult as BundleResult
    from photogrammetry.bundle.adjustment import adjust as adjust
    from photogrammetry.bundle.problem import BundleProblem as BundleProblem
    from photogrammetry.bundle.problem import CameraModel as CameraModel
    from photogrammetry.bundle.problem import ResidualSpace as ResidualSpace
    from photogrammetry.bundle.state import BundleState as BundleState

__getattr__, __dir__, __all__ = lazy_face(__name__)
