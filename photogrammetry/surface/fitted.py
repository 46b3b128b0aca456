"""Points of a surface with their joint covariance, and what a fit of a surface to them gave."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, float_array
from photogrammetry.surface.design import Reference


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints(ShortRepr):
    """Points of a surface with their joint covariance.

    ids length n: Names.
    points_m (n, 3): Coordinates [m].
    covariance_m2 (3 n, 3 n): Joint covariance; singular under an inner datum, which is fine [m^2].
    InputError: Shapes that do not fit, or values that are not finite.
    """

    ids: tuple[str, ...]
    points_m: FloatArray
    covariance_m2: FloatArray

    def __post_init__(self) -> None:
        count = len(self.ids)
        object.__setattr__(self, "points_m", float_array("points_m", self.points_m, (count, 3)))
        covariance = float_array("covariance_m2", self.covariance_m2, (3 * count, 3 * count))
        object.__setattr__(self, "covariance_m2", covariance)

    def chosen(self, which: BoolArray) -> "SurfacePoints":
        """Return the marked points."""
        rows = np.repeat(which, 3)
        names = tuple(name for name, one in zip(self.ids, which, strict=True) if one)
        return SurfacePoints(names, self.points_m[which], self.covariance_m2[np.ix_(rows, rows)])

    @property
    def sigma_m(self) -> FloatArray:
        """Standard deviations, shape (n, 3) [m]."""
        return np.sqrt(np.maximum(np.diag(self.covariance_m2), 0.0)).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class FitChoices:
    """What is fitted.

    pose: Whether the surface may move; otherwise the start's frame is the design's.
    curvature: Whether the lengths of the design (focal lengths, radius) are free.
    robust: Whether points far from the rest are left out, with their reason.
    family_significance: Probability that any good point is left out.
    """

    pose: bool = True
    curvature: bool = False
    robust: bool = True
    family_significance: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFit(ShortRepr):
    """A surface fitted to points.

    reference: The surface, with the curvature that was found.
    design_from_world: From the frame of the points to that of the surface.
    points: All points in the surface's frame; the covariance includes that of the fit.
    deviation_m (n,): Orthogonal distance from the surface, positive on its +z side [m].
    normals (n, 3): Unit normals at the feet.
    covariance_deviation_m2 (n, n): Joint covariance of the deviations from errors of measurement, the fit's own
        share included [m^2].
    outliers (n,): Points that the fit did not use.
    tests (n,): Deviation over its sigma with the shape's roughness included: what decided about outliers.
    shape_sigma_m: RMS of what the surface itself deviates from the fit, beyond errors of measurement; 0 where these
        explain everything [m].
    variance_factor: Squared deviations, weighted with the covariance of measurement alone, over the redundancy: 1
        if the surface is the design and the sigmas are right.
    redundancy: Points used less determined parameters.
    held: Motions that change nothing, or so little that points would slide along the surface by a hundredth of
        their extent; they stay as at the start.
    parameters: The estimated numbers.
    """

    reference: Reference
    design_from_world: RigidTransform
    points: SurfacePoints
    deviation_m: FloatArray
    normals: FloatArray
    covariance_deviation_m2: FloatArray
    outliers: BoolArray
    tests: FloatArray
    shape_sigma_m: float
    variance_factor: float
    redundancy: int
    held: tuple[str, ...]
    parameters: "FitParameters"

    @property
    def sigma_deviation_m(self) -> FloatArray:
        """Standard deviation of each deviation from errors of measurement, shape (n,) [m]."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance_deviation_m2), 0.0)))

    @property
    def deviation_z_m(self) -> FloatArray:
        """Deviation along z instead of along the normal, shape (n,) [m]."""
        return np.asarray(self.deviation_m / self.normals[:, 2])

    @property
    def covariance_deviation_z_m2(self) -> FloatArray:
        """Joint covariance of the deviations along z, shape (n, n) [m^2]."""
        scale = 1 / self.normals[:, 2]
        return np.asarray(self.covariance_deviation_m2 * scale[:, None] * scale)

    @property
    def rms_deviation_m(self) -> float:
        """RMS deviation along the normal of the points used [m]."""
        return float(np.sqrt(np.mean(self.deviation_m[~self.outliers] ** 2)))

    @property
    def sigma_rms_deviation_m(self) -> float:
        """Standard deviation of the RMS deviation from errors of measurement [m]."""
        used = ~self.outliers
        values, covariance = self.deviation_m[used], self.covariance_deviation_m2[np.ix_(used, used)]
        size = float(values @ values)
        # First order around the RMS found, second order where noise is all there is: var(|e|^2) = 4 e'Ce - 2 tr(C^2)
        # with e measured; never below the noise's own 2 tr(C^2).
        spread = 4 * float(values @ covariance @ values) - 2 * float((covariance**2).sum())
        spread = max(spread, 2 * float((covariance**2).sum()))
        return float(np.sqrt(spread) / (2 * np.sqrt(size * used.sum()))) if size > 0 else 0.0


class FittedLength(NamedTuple):
    """A length with its sigma, and the share of errors of measurement in that [m]."""

    length_m: float
    sigma_m: float
    measurement_sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class FitParameters:
    """Pose step and curvatures with their covariances; steps of `RigidTransform.moved` of ``design_from_world``.

    covariance (6 + k, 6 + k): From errors of measurement and from the roughness of the surface, of which the points
        are a sample.
    covariance_measurement (6 + k, 6 + k): From errors of measurement alone: how well the fit to these very points
        is known.
    curvature_names length k: Lengths that were estimated.
    curvatures_per_m (k,): 1 / length [1/m].
    """

    covariance: FloatArray
    covariance_measurement: FloatArray
    curvature_names: tuple[str, ...]
    curvatures_per_m: FloatArray

    def lengths(self) -> dict[str, FittedLength]:
        """Return each length; infinite where flat."""
        found = {}
        for k, name in enumerate(self.curvature_names):
            curvature = float(self.curvatures_per_m[k])
            length = 1 / curvature if curvature else float("inf")
            both = (self.covariance[6 + k, 6 + k], self.covariance_measurement[6 + k, 6 + k])
            whole, measured = (float(np.sqrt(max(variance, 0.0))) * length**2 for variance in both)
            found[name] = FittedLength(length, whole, measured)
        return found
