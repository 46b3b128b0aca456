"""Canting and focal length of each facet from the points on it, with the covariance of all points."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.normal_angles import tangents
from heliogauge.validate import BoolArray, FloatArray, freeze
from photogrammetry.surface.design import DesignSurface
from photogrammetry.surface.fit import roughness
from photogrammetry.surface.fitted import SurfaceFit


@dataclass(frozen=True, slots=True, eq=False)
class FacetPoints:
    """A facet to examine.

    facet: Outline and reference point; design and outline in the frame of the fit.
    design: Its design in the frame of the fit.
    members (n,): Its points.
    """

    facet: Facet
    design: DesignSurface
    members: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class FacetCanting:
    """How a facet stands against its design.

    canting (2,): Components in x and y of the angle from the design's normal to the facet's at its reference point
        (`heliogauge.slopes.normal_angles`): +x means that the surface rises more towards +x, so that the normal leans
        to -x [rad].
    covariance_canting (2, 2): From errors of measurement and the facet's roughness [rad^2].
    sigma_canting_measurement (2,): From errors of measurement alone [rad].
    piston_m, sigma_piston_m: Height over the design along its normal [m].
    rms_m: RMS deviation after canting, piston and focal length [m].
    length_m, sigma_length_m: Focal length or radius, NaN where the design has none, has two, or the points are too
        few [m].
    length_name: Its name; empty without it.
    """

    name: str
    n_points: int
    canting: FloatArray
    covariance_canting: FloatArray
    sigma_canting_measurement: FloatArray
    piston_m: float
    sigma_piston_m: float
    rms_m: float
    length_m: float
    sigma_length_m: float
    length_name: str

    @property
    def sigma_canting(self) -> FloatArray:
        """Standard deviation of the canting in x and y, shape (2,) [rad]."""
        return np.sqrt(np.diag(self.covariance_canting))


def facet_canting(fit: SurfaceFit, facet: FacetPoints) -> FacetCanting:
    """Determine how one facet stands against its design.

    fit: All points in the frame of the design, aligned as a whole.
    Returns: Tip, tilt and piston, with the focal length free where six points or more allow it.
    EstimationError: Fewer than three points that are not outliers, or all on one line.

    The facet turns about two tangents at its reference point and shifts along its normal: its motion in its own plane
    is not seen by distances. The estimator is linear in the deviations, whose joint covariance contains the alignment
    of all facets; roughness as in `photogrammetry.surface.fit.fit_surface`.
    """
    members = facet.members & ~fit.outliers
    count = int(members.sum())
    points = fit.points.points_m[members]
    feet = facet.design.feet(points)
    x, y = facet.facet.reference_point_m.tolist()
    quadric = facet.design.quadric
    center, normal = np.array([x, y, float(quadric.height(x, y))]), quadric.normal(x, y)
    first = np.cross([0.0, 1.0, 0.0], normal)
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)])
    # Distances of points on a facet that turned by w about its center grow by (w x arm) . n.
    jacobian = np.column_stack([np.cross(points - center, feet.normals) @ axes.T, feet.normals @ normal])
    with_length = feet.d_distance_d_curvature.shape[1] == 1 and count >= 6
    if with_length:
        # A point on a surface of larger curvature lies where the design's distance is not yet reduced by it.
        jacobian = np.column_stack([jacobian, -feet.d_distance_d_curvature])
    _refuse_line(facet.facet.name, jacobian[:, :3], count)
    covariance = fit.covariance_deviation_m2[np.ix_(members, members)]
    rough, _ = roughness(feet.distance_m, jacobian, covariance)
    whole = covariance + (rough**2 + 1e-8 * float(np.trace(covariance)) / count + 1e-24) * np.eye(count)
    weighted = np.linalg.solve(whole, jacobian)
    estimator = np.linalg.solve(jacobian.T @ weighted, weighted.T)
    step = estimator @ feet.distance_m
    measured = estimator @ covariance @ estimator.T
    total = measured + rough**2 * estimator @ estimator.T
    # Turned by w the normal moves by w x n; angles count against e_x and e_y.
    to_angle = -tangents(*(-normal[:2] / normal[2])) @ np.cross(axes, normal).T
    rest = feet.distance_m - jacobian @ step
    length = _length(facet.design, step, total) if with_length else _Length()
    return FacetCanting(
        facet.facet.name,
        count,
        freeze(to_angle @ step[:2]),
        freeze(to_angle @ total[:2, :2] @ to_angle.T),
        freeze(np.sqrt(np.diag(to_angle @ measured[:2, :2] @ to_angle.T))),
        float(step[2]),
        float(np.sqrt(total[2, 2])),
        float(np.sqrt(np.mean(rest**2))),
        *length,
    )


def _refuse_line(name: str, columns: FloatArray, count: int) -> None:
    scale = np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-12)
    if count < 3 or np.linalg.svd(columns / scale, compute_uv=False)[-1] < 1e-6:
        raise EstimationError(
            f"canting of facet {name}: its {count} points do not determine its normal; three or more that are not on "
            "one line are needed"
        )


class _Length(NamedTuple):
    """Focal length or radius with sigma [m], and which of them it is."""

    length_m: float = float("nan")
    sigma_m: float = float("nan")
    name: str = ""


def _length(design: DesignSurface, step: FloatArray, total: FloatArray) -> _Length:
    curvature = float(design.curvatures_per_m[0] + step[3])
    length = 1 / curvature if curvature else float("inf")
    return _Length(length, float(np.sqrt(total[3, 3])) * length**2, design.curvature_names[0])
