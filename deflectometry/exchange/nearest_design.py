"""The simple design that is nearest to slopes, proposed where none was given or another one does not fit."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from deflectometry.exchange.slope_points import SlopePoints
from deflectometry.pipeline.design_check import is_other_shape
from heliogauge.geometry.surfaces import Quadric, quadric
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.models import DesignKeys
from heliogauge.results.slope_export import fit_monomials
from heliogauge.validate import FloatArray

#: Harmless: among shapes that fit nearly alike the simpler one is proposed.
_ALIKE = 1.1
#: Three points, of two slopes each, are met by the five terms of a quadratic surface whatever they say.
_FEWEST = 3


@dataclass(frozen=True, slots=True, eq=False)
class NearestDesign:
    """A design near slopes.

    keys: Of [mirror]: design, and its length or coefficients.
    rms_rad: RMS angle between its normals and those of the slopes, without the mean tilt [rad].
    """

    keys: Mapping[str, Any]
    rms_rad: float

    @property
    def options(self) -> str:
        """As options of the import, or as lines of measurement.toml for a shape that the import has no options for."""
        if self.keys["design"] == "quadric":
            values = ", ".join(f"{one:.6g}" for one in self.keys["coefficients"])
            return f'[mirror] design = "quadric", coefficients = [{values}] in measurement.toml'
        lengths = (f" --{name.replace('_', '-')} {value:.4g}" for name, value in self.keys.items() if name != "design")
        return f"--design {self.keys['design']}{''.join(lengths)}"

    def describe(self) -> str:
        """Say which surface it is."""
        return build_design(DesignKeys(**self.keys)).describe()


def are_of_surface(points: SlopePoints) -> bool:
    """Return whether slopes determine a quadratic: three points that are not on a line."""
    known = points.measured
    places = np.column_stack([points.x_m[known], points.y_m[known]])
    return len(places) > _FEWEST and np.linalg.matrix_rank(places - places.mean(axis=0)) == places.shape[1]


def curvatures(points: SlopePoints) -> FloatArray:
    """Return A, B, E of the surface ``A x^2 + B y^2 + E x y`` (and tilts) fitted to slopes, shape (3,) [1/m]."""
    known = points.measured
    places = points.x_m[known], points.y_m[known]
    found = fit_monomials(*places, points.slope_x[known], points.slope_y[known], 2)
    # Powers of x fall: 1, x, y, x^2, x y, y^2.
    return np.array([found[3], found[5], found[4]])


def nearest_design(points: SlopePoints, surface_per_m: FloatArray) -> NearestDesign:
    """Return the simple design that is nearest to slopes.

    surface_per_m (3,): A, B, E of `curvatures`, or those that the file states of its surface.
    """
    a, b, e = surface_per_m.tolist()
    shapes: list[dict[str, Any]] = [{"design": "plane"}]
    shapes += [{"design": "trough", "focal_length_m": 0.25 / a}] if a > 0 else []
    shapes += [{"design": "paraboloid", "focal_length_m": 0.5 / (a + b)}] if a + b > 0 else []
    found = [NearestDesign(keys, rms_off(points, build_design(DesignKeys(**keys)))) for keys in shapes]
    least = min(one.rms_rad for one in found)
    best = next(one for one in found if one.rms_rad <= _ALIKE * least)
    coefficients = (a, b, 0.0, 0.0, e, 0.0)
    whole = NearestDesign(
        {"design": "quadric", "coefficients": coefficients}, rms_off(points, quadric(list(coefficients)))
    )
    return whole if is_other_shape(best.rms_rad, whole.rms_rad) else best


def rms_off(points: SlopePoints, design: Quadric) -> float:
    """Return the RMS angle between the normals of slopes and of a design, without the mean tilt [rad]."""
    known = points.measured
    at = design.gradient(points.x_m[known], points.y_m[known])
    measured = points.slope_x[known], points.slope_y[known]
    turned = [np.arctan(one) - np.arctan(other) for one, other in zip(measured, at, strict=True)]
    inside = np.isfinite(turned).all(axis=0)
    return float(np.sqrt(sum(np.var(one[inside]) for one in turned))) if inside.any() else float("inf")
