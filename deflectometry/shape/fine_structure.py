"""How well the size of a mirror's waviness is known: blur lowers it, and a wrong scale of the screen stretches it."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from deflectometry.pose.outline_edges import edge_blur_px
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.common_modes import MovedInput
from deflectometry.shape.facet_pixels import PixelSamples, spread_indices, trace_samples
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import FacetSamples, FittedSurface, ShapeSolution, slopes_at
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import AnyFloatArray, BoolArray, Float32Array, FloatArray

#: Step on the display for the derivative of the slopes, a thousandth of its width and height.
_STEP = 1e-3
#: Pixels that stand for a facet: what a step on the display does to the slope changes little over it.
_PIXELS = 25
#: A facet with fewer measured pixels shows no waviness.
_FEWEST_PIXELS = 200
#: Samples whose waviness stands for that of all.
_SPACED_SAMPLES = 50_000
#: Waviness below this share of the noise's variance is not told from it: 200 pixels give a variance to a tenth.
_LEAST_WAVINESS = 0.1


def fine_share(responses: FloatArray, image: SlopeImage, edge_width_px: float) -> FloatArray:
    """Return the relative standard deviation of the waviness in x and in y, shape (2,).

    responses (k, 2, 2): Of one facet, from `fine_responses`.
    image: Its slopes.
    edge_width_px: Width of the mirror's edges in the image; NaN where it was not measured [px].

    Common modes are smooth: they hold what one sigma of the set-up does to the mirror's shape, but not that waviness is
    measured on the scale of the screen's size and distance. The image is blurred as its edges are wide, and waviness
    with it; the share that this takes away is about the share that the same blur takes away once more.
    """
    scale = np.linalg.norm(np.diagonal(responses, axis1=1, axis2=2), axis=0)
    return np.asarray(np.hypot(scale, _blur_share(image, edge_width_px)))


def fine_responses(
    setup: Setup,
    sample: PixelSamples,
    solution: ShapeSolution,
    inputs: Sequence[MovedInput],
    surface: FittedSurface,
) -> FloatArray:
    """Return what one sigma of each input adds to waviness, in both slopes for that of either, shape (k, 2, 2).

    sample, surface: Pixels and smooth shape of one facet.
    inputs: Camera, screen and pose with one of them moved after the other, from `moved_inputs`.

    A scale of the screen stretches waviness; one turned about its own normal makes slopes in y of those in x.
    """
    chosen = spread_indices(len(sample.pixels_px), _PIXELS)
    few = replace(sample, pixels_px=sample.pixels_px[chosen], u=sample.u[chosen], v=sample.v[chosen])
    cam_from_mirror = solution.cam_from_mirror
    start = np.linalg.inv(_slopes_by_display(setup, few, cam_from_mirror, surface))
    ratios = [_slopes_by_display(one.setup, few, one.cam_from_mirror, surface) @ start for one in inputs]
    return np.array([np.nanmedian(one, axis=0) - np.eye(2) for one in ratios]).reshape(-1, 2, 2)


def place_covariance(
    setup: Setup,
    sample: PixelSamples,
    solution: ShapeSolution,
    inputs: Iterable[MovedInput],
    surface: FittedSurface,
) -> FloatArray:
    """Return the covariance of the place on the mirror that a pixel sees, mean over a facet, shape (2, 2) [m^2].

    sample, surface: Pixels and smooth shape of one facet.
    inputs: Camera, screen, pose and places of facets with one of them moved after the other.
    """
    chosen = spread_indices(len(sample.pixels_px), _PIXELS)
    few = replace(sample, pixels_px=sample.pixels_px[chosen], u=sample.u[chosen], v=sample.v[chosen])

    def places(traced: FacetSamples, cam_from_mirror: RigidTransform) -> FloatArray:
        facet_from_cam = (cam_from_mirror @ traced.facet.ensemble_from_facet).inverse()
        return surface.intersect(facet_from_cam.translation_m, facet_from_cam.rotation @ traced.rays_cam)[:2]

    as_given = trace_samples(setup, [few])[0]
    start = places(as_given, solution.cam_from_mirror)
    total = np.zeros((2, 2))
    for one in inputs:
        traced = as_given if one.facets is not None and sample.facet.name not in one.facets else one.sampled(few)
        moved = one.times * (places(traced, one.cam_from_mirror) - start)
        moved = moved[:, np.isfinite(moved).all(axis=0)]
        total += moved @ moved.T / max(moved.shape[1], 1)
    return total


def with_waviness_out_of_place(image: SlopeImage, surface: FittedSurface, covariance_m2: FloatArray) -> SlopeImage:
    """Return slopes whose sigmas hold that the waviness of the mirror stands aside by what its place is uncertain.

    covariance_m2 (2, 2): Of the place that a pixel sees, from `place_covariance` [m^2].

    Common modes hold what a shift does to the smooth shape. What is finer stands aside with it: its gradient times the
    shift, an RMS over the facet. The gradient is that between neighbouring samples, which of a wave of five samples
    loses a fifth of the square; what two steps lose more says how much.
    """
    # Some rows of large images, each with the two below it.
    step = max(1, image.x_m.size // _SPACED_SAMPLES)
    rows = np.arange(0, max(image.x_m.shape[0] - 2, 0), step)[:, None] + np.arange(3)
    places = np.stack([image.x_m[rows], image.y_m[rows]])
    measured = ((image.slope_x, image.sigma_x), (image.slope_y, image.sigma_y))
    sigmas = []
    for (slope, sigma), smooth in zip(measured, surface.gradient(*places), strict=True):
        near, far = (_square_of_gradient(places, slope[rows] - smooth, sigma[rows], lag) for lag in (1, 2))
        # (sin a / a)^2 is 1 - a^2 / 3 over one step and 1 - 4 a^2 / 3 over two.
        found = near + (near - far) / 3 if np.isfinite(far).all() else near
        values, vectors = np.linalg.eigh(np.nan_to_num(found))
        waves = (vectors * np.maximum(values, 0.0)) @ vectors.T
        sigmas.append(np.hypot(sigma, np.sqrt(np.sum(waves * covariance_m2))).astype(np.float32))
    return replace(image, sigma_x=sigmas[0], sigma_y=sigmas[1])


def _square_of_gradient(places_m: FloatArray, values: FloatArray, sigma: AnyFloatArray, lag: int) -> FloatArray:
    """Return the mean of ``g g^T``, g the gradient of values over some samples, without noise, (2, 2) [1/m^2].

    Shapes: places_m (2, n, 3, w), values, sigma (n, 3, w).
    lag: 1 or 2 samples.
    Returns: NaN where no three samples are seen together.
    """
    here, right, down = (
        np.s_[..., 0, :-lag],
        np.s_[..., 0, lag:],
        np.s_[..., lag, :-lag],
    )
    change = np.stack([values[one] - values[here] for one in (right, down)])
    seen = np.isfinite(change).all(axis=0)
    if not seen.any():
        return np.full((2, 2), np.nan)
    steps = np.stack([(places_m[one] - places_m[here])[:, seen] for one in (right, down)])
    inverse = np.linalg.inv(np.moveaxis(steps, -1, 0))
    gradient = np.einsum("nij,jn->in", inverse, change[:, seen])
    own, *others = (sigma[one][seen].astype(np.float64) ** 2 for one in (here, right, down))
    noise = np.array([[own + others[0], own], [own, own + others[1]]])
    of_noise = np.einsum("nij,jkn,nlk->il", inverse, noise, inverse)
    return np.asarray((gradient @ gradient.T - of_noise) / np.count_nonzero(seen))


def _slopes_by_display(
    setup: Setup, sample: PixelSamples, cam_from_mirror: RigidTransform, surface: FittedSurface
) -> FloatArray:
    """Return the derivatives of slope_x and slope_y after u and v at each pixel, shape (n, 2, 2)."""
    facet_from_cam = (cam_from_mirror @ sample.facet.ensemble_from_facet).inverse()
    camera = facet_from_cam.translation_m
    slopes = []
    for right, down in ((0.0, 0.0), (_STEP, 0.0), (0.0, _STEP)):
        (traced,) = trace_samples(setup, [replace(sample, u=sample.u + right, v=sample.v + down)])
        points = surface.intersect(camera, facet_from_cam.rotation @ traced.rays_cam)
        screen = facet_from_cam.rotation @ traced.screen_cam_m + camera[:, None]
        slopes.append(np.stack(slopes_at(points, camera, screen)))
    changes = np.stack([slopes[1] - slopes[0], slopes[2] - slopes[0]], axis=1) / _STEP
    return np.moveaxis(changes, -1, 0)


def _blur_share(image: SlopeImage, edge_width_px: float) -> FloatArray:
    """Return the share of the waviness that a blur as wide as the edges takes away, shape (2,)."""
    # In samples: those of a lattice are many pixels apart.
    blur_px = edge_blur_px(edge_width_px) / image.grid.spacing_px
    seen = np.isfinite(image.slope_x) & np.isfinite(image.slope_y)
    if not blur_px > 0 or np.count_nonzero(seen) < _FEWEST_PIXELS:
        return np.zeros(2)
    left = _beside_quadratic(image, seen)
    weight = _blurred(seen.astype(np.float32), blur_px)
    # Where a third of the weight is beyond the mirror a blurred slope is no mean about its pixel.
    inner = np.flatnonzero(seen & (weight > 2 / 3))
    single = np.zeros((2 * int(np.ceil(4 * blur_px)) + 3,) * 2, dtype=np.float32)
    single[len(single) // 2, len(single) // 2] = 1.0
    of_noise, weight = _mean_square(_blurred(single, blur_px)) * single.size, weight.take(inner)
    lost = []
    for waves, sigma in zip(left, (image.sigma_x, image.sigma_y), strict=True):
        noise = _mean_square(sigma.take(inner))
        before = _mean_square(waves.take(inner)) - noise
        after = _mean_square(_blurred(waves, blur_px).take(inner) / weight) - of_noise * noise
        lost.append(1.0 - np.sqrt(min(max(after, 0.0) / before, 1.0)) if before > _LEAST_WAVINESS * noise else 0.0)
    return np.array(lost)


def _mean_square(values: Float32Array) -> float:
    return float(np.mean(np.square(values, dtype=np.float64)))


def _blurred(values: Float32Array, blur_px: float) -> Float32Array:
    """Blur an image by a Gaussian out to four of its standard deviations, with zero beyond the edge."""
    width = 2 * int(4 * blur_px + 0.5) + 1
    return np.asarray(cv2.GaussianBlur(values, (width, width), blur_px, borderType=cv2.BORDER_CONSTANT), np.float32)


def _beside_quadratic(image: SlopeImage, seen: BoolArray) -> Float32Array:
    """Return what the best quadratic surface leaves of the slopes, shape (2, h, w); 0 where nothing was seen."""
    index = np.flatnonzero(seen)
    slopes = np.stack([image.slope_x.take(index), image.slope_y.take(index)])
    linear = np.stack([np.ones(index.size), image.x_m.take(index), image.y_m.take(index)])
    linear[1:] -= linear[1:].mean(axis=1, keepdims=True)
    # Of 1, x and y in the slopes in x and in y for two curvatures, twist and two tilts.
    shares = np.zeros((5, 2, 3))
    shares[0, 0, 1] = shares[1, 1, 2] = shares[2, 0, 2] = shares[2, 1, 1] = shares[3, 0, 0] = shares[4, 1, 0] = 1.0
    products = np.einsum("kci,ij,lcj->kl", shares, linear @ linear.T, shares)
    found = np.linalg.solve(products, np.einsum("kci,ci->k", shares, slopes @ linear.T))
    slopes -= np.tensordot(found, shares, axes=1) @ linear
    left = np.zeros((2, *seen.shape), dtype=np.float32)
    left.reshape(2, -1)[:, index] = slopes
    return left
