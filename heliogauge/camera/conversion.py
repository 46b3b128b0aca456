"""Refit a lens in the other direction of Brown's model, for programs that know only one, with the residual stated."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from heliogauge.camera.brown_polynomial import coefficient_derivatives
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray

#: Nodes of the fit along the longer side of the image; 41 x 31 nodes and 401 x 301 give residuals equal to 1 %.
_NODES = 41
_ITERATIONS = 20


class DirectionFit(NamedTuple):
    """A camera with its lens in the other direction (see `convert_direction`)."""

    camera: Camera
    largest_residual_px: float
    rms_residual_px: float
    covered_share: float


def convert_direction(camera: Camera, direction: DistortionDirection) -> DirectionFit:
    """Fit the coefficients of the other direction to a lens over its image.

    camera: The camera. Its own model is exact in both directions; convert only to hand it to another program.
    Returns: ``camera`` with the same focal lengths, principal point and skew; its covariance is propagated through the
        fit. ``largest_residual_px`` and ``rms_residual_px`` compare the image points of the same rays over the
        whole image [px]; ``covered_share`` is the share of the image where the given lens is one-to-one: nothing is
        known of the rest.
    EstimationError: The best coefficients of the other direction fold inside the image.

    Least squares on the image points of a regular grid of nodes that includes the image's corners: linear start,
    then Gauss-Newton. The inverse of a Brown polynomial is no Brown polynomial, so a residual remains.
    """
    direction = DistortionDirection(direction)
    pixels = _nodes(camera)
    rays = camera.cast_rays(pixels)
    seen = np.isfinite(rays[:, 2])
    share = float(seen.mean())
    pixels, rays = pixels[seen], rays[seen]
    if direction is camera.distortion.direction:
        return DirectionFit(camera, 0.0, 0.0, share)
    fitted = _fit(camera, direction, pixels, rays)
    residual = np.hypot(*(fitted.project(rays) - pixels).T)
    if not np.isfinite(residual).all():
        raise EstimationError(
            f"camera: no {direction} coefficients describe this lens over its image "
            f"({np.count_nonzero(~np.isfinite(residual))} of {residual.size} nodes fold); keep its own direction, "
            "which is evaluated exactly both ways"
        )
    fitted = fitted.with_covariance(_propagated_covariance(camera, fitted, rays))
    return DirectionFit(fitted, float(residual.max()), float(np.sqrt((residual**2).mean())), share)


def _nodes(camera: Camera) -> FloatArray:
    longer = max(camera.width_px, camera.height_px)
    counts = [max(5, round(_NODES * size / longer)) for size in (camera.width_px, camera.height_px)]
    columns = np.linspace(-0.5, camera.width_px - 0.5, counts[0])
    rows = np.linspace(-0.5, camera.height_px - 0.5, counts[1])
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def _fit(camera: Camera, direction: DistortionDirection, pixels: FloatArray, rays: FloatArray) -> Camera:
    ideal = rays[:, :2] / rays[:, 2:]
    measured = camera.distortion.distort(ideal)
    source, target = (ideal, measured) if direction is DistortionDirection.IDEAL_TO_MEASURED else (measured, ideal)
    # The polynomial is linear in its coefficients; its residual is in normalised coordinates, close enough to start.
    design = coefficient_derivatives(source[:, 0], source[:, 1]).reshape(-1, 5)
    coefficients = _solve(design, (target - source).ravel())
    other = replace(camera, distortion=BrownDistortion(direction=direction))

    def camera_of(values: FloatArray) -> Camera:
        return other.with_parameters(np.concatenate((camera.parameters[:5], values)))

    best, best_sum = camera_of(coefficients), np.inf
    for _ in range(_ITERATIONS):
        trial = camera_of(coefficients)
        projected, _, d_parameters = trial.project_with_jacobians(rays)
        residual = (pixels - projected).ravel()
        square_sum = float(residual @ residual)
        if not square_sum < best_sum * (1 - 1e-13):
            break
        best, best_sum = trial, square_sum
        coefficients = coefficients + _solve(d_parameters[..., 5:].reshape(-1, 5), residual)
    return best


def _solve(design: FloatArray, right_side: FloatArray) -> FloatArray:
    # s, s^2 and s^3 of a narrow lens differ by many powers of ten: scale the columns before the rank is judged.
    scale = np.linalg.norm(design, axis=0)
    solution: FloatArray = np.linalg.lstsq(design / scale, right_side, rcond=None)[0] / scale
    return solution


def _propagated_covariance(given: Camera, fitted: Camera, rays: FloatArray) -> FloatArray:
    """Carry the covariance through the fit, to first order in the residual (0.1 px leaves a few per cent of sigma)."""
    d_given = given.project_with_jacobians(rays)[2].reshape(-1, 10)
    d_fitted = fitted.project_with_jacobians(rays)[2].reshape(-1, 10)
    # The first five are kept unchanged; the coefficients take up what that leaves of the image's change.
    left = d_given.copy()
    left[:, :5] -= d_fitted[:, :5]
    scale = np.linalg.norm(d_fitted[:, 5:], axis=0)
    lower = np.linalg.lstsq(d_fitted[:, 5:] / scale, left, rcond=None)[0] / scale[:, None]
    transfer = np.vstack((np.eye(10)[:5], lower))
    covariance = transfer @ given.covariance @ transfer.T
    return np.asarray(0.5 * (covariance + covariance.T))
