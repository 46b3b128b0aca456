"""Dots that a mirror of design shape will show: where each will be in the photo, and how sure its centre will be."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from deflectometry.dots.found_dots import FoundDots, find_dots
from deflectometry.planning.pipeline.bench import Bench
from deflectometry.planning.predicted_sight import FacetSight, trace_pixels
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.targets import Polarity

#: Dots along each side of the drawn sample, and parts of a pixel over which their light is integrated.
_SAMPLE, _PARTS = 8, 8
#: Steps from where the interpolated map has a dot to where it is: of 0.1 px, the second leaves 1e-3 of a pixel.
_ROUNDS = 3
#: Least side of the drawn sample: dots are not looked for in smaller images [px].
_LEAST_SIDE_PX = 16
#: Dots nearer to an edge than this many radii are cut by it.
_WHOLE = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class DotPlaces:
    """Dots that one facet will show whole.

    number (n, 2): Column and row in the table.
    centers_px (n, 2), shapes_px2 (n, 2, 2): Their centres and ellipses in the photo.
    """

    number: IntArray
    centers_px: FloatArray
    shapes_px2: FloatArray


def places_of_dots(bench: Bench, sight: FacetSight, screen: DotScreen, radius_m: float) -> DotPlaces:
    """Return the dots that a facet will show whole.

    sight, screen: Of the bench.
    EstimationError: It shows too little of the field for a lattice.
    """
    from scipy.interpolate import CloughTocher2DInterpolator

    row, column = np.nonzero(sight.inside & sight.on_screen)
    steps = np.stack([screen.shape[1] - 1, screen.shape[0] - 1])
    seen = np.stack([sight.u[row, column], sight.v[row, column]], axis=1) * steps
    pixels = np.stack([column + sight.columns.start, row + sight.rows.start], axis=1).astype(np.float64)
    if len(seen) < 9:
        raise EstimationError(f"facet {sight.facet.name} shows the field on {len(seen)} px only")
    # Some thousands of pixels lead to every dot; tracing what is seen there takes it to its place.
    some = np.unique(np.linspace(0, len(seen) - 1, 6000).astype(np.intp))
    from_dots = CloughTocher2DInterpolator(seen[some], pixels[some])
    down, across = (one.ravel() for one in np.mgrid[: screen.shape[0], : screen.shape[1]])
    places = np.stack([across, down], axis=1).astype(np.float64)
    near = ((places >= seen.min(axis=0)) & (places <= seen.max(axis=0))).all(axis=1)
    near &= np.isfinite(screen.xyz_m[down, across, 0])
    places = places[near]
    centers = from_dots(places)
    radius = radius_m / screen.spacing_m
    by_column, by_row = (
        (from_dots(places + step) - from_dots(places - step)) / (2 * 0.25) for step in 0.25 * np.eye(2)
    )
    to_pixels = np.stack([by_column, by_row], axis=-1)
    for _ in range(_ROUNDS):
        there = np.flatnonzero(np.isfinite(centers).all(axis=1) & np.isfinite(to_pixels).all(axis=(1, 2)))
        u, v, _ = trace_pixels(bench.setup, bench.cam_from_mirror, sight.facet, centers[there])
        off = places[there] - np.stack([u, v], axis=1) * steps
        centers[there] += np.einsum("nij,nj->ni", to_pixels[there], off)
    jacobian = to_pixels * radius
    shapes = jacobian @ jacobian.swapaxes(1, 2)
    # Whole: the farthest points of the dot along both axes of the image are in the mirror, too.
    reach = _WHOLE * np.sqrt(np.stack([shapes[:, 0, 0], shapes[:, 1, 1]], axis=1))
    whole = np.asarray(np.isfinite(shapes).all(axis=(1, 2)) & np.isfinite(centers).all(axis=1))
    for side in np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
        whole &= _in_facet(sight, centers + side * reach)
    number = np.stack([across[near] + screen.first[0], screen.first[1] - down[near]], axis=1)
    return DotPlaces(number[whole], centers[whole], shapes[whole])


def _in_facet(sight: FacetSight, places_px: FloatArray) -> BoolArray:
    at = np.rint(np.nan_to_num(places_px, nan=-1e6)).astype(np.intp) - [sight.columns.start, sight.rows.start]
    height, width = sight.inside.shape
    there = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    inside = np.zeros(len(at), dtype=np.bool_)
    inside[there] = sight.inside[at[there, 1], at[there, 0]]
    return inside


def measured_sample(
    places: Sequence[DotPlaces], contrast_dn: float, noise_dn: float, blur_px: float, polarity: Polarity
) -> FoundDots:
    """Return dots of the usual size, drawn with blur and noise and found as those of a photo will be.

    EstimationError: Dots that are too small, too near to each other or too faint to be found.
    """
    shapes = np.concatenate([one.shapes_px2 for one in places])
    shape = np.median(shapes, axis=0)
    spacing = float(np.median([_spacing(one) for one in places]))
    size = max(int(np.ceil((_SAMPLE + 1) * spacing)), _LEAST_SIDE_PX)
    rng = np.random.default_rng(0)
    middle = spacing * (np.stack(np.meshgrid(np.arange(_SAMPLE), np.arange(_SAMPLE)), axis=-1).reshape(-1, 2) + 1.0)
    middle = middle + rng.uniform(-0.5, 0.5, middle.shape)
    part = (np.arange(size * _PARTS) + 0.5) / _PARTS - 0.5
    grid = np.stack(np.meshgrid(part, part), axis=-1)
    dark = np.zeros(grid.shape[:2], dtype=np.float32)
    inverse = np.linalg.inv(shape)
    for one in middle:
        off = grid - one
        dark[np.einsum("...i,ij,...j->...", off, inverse, off) < 1] = 1
    light = dark.reshape(size, _PARTS, size, _PARTS).mean(axis=(1, 3))
    if blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), blur_px)
    signed = -light if polarity is Polarity.BLACK_ON_WHITE else light
    ground = 30.0 + (contrast_dn if polarity is Polarity.BLACK_ON_WHITE else 0.0)
    photo = ground + contrast_dn * signed + noise_dn * rng.standard_normal(light.shape)
    try:
        return find_dots(np.clip(photo, 0, None).astype(np.float32), np.ones(light.shape, dtype=np.bool_), polarity)
    except EstimationError as error:
        axes = np.sqrt(np.linalg.eigvalsh(shape))
        raise EstimationError(
            f"dots of {2 * axes[0]:.1f} px x {2 * axes[1]:.1f} px, {spacing:.1f} px apart, with {contrast_dn:g} DN of "
            f"contrast and {noise_dn:g} DN of noise cannot be measured ({error}); make them larger or come nearer"
        ) from None


def _spacing(one: DotPlaces) -> float:
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(one.centers_px).query(one.centers_px, 2)[0][:, 1]))


def predicted_dots(places: DotPlaces, sample: FoundDots) -> FoundDots:
    """Return the dots of one facet as they will be found."""
    count = len(places.number)
    usual = np.median(sample.covariance_px2, axis=0)
    return FoundDots(
        places.centers_px,
        np.broadcast_to(usual, (count, 2, 2)),
        places.number,
        np.full(count, float(np.median(sample.contrast_dn))),
        sample.residual_dn,
        0,
        places.shapes_px2,
        sample.blur_px,
    )
