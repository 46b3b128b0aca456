"""The centre of a circle's image is not the image of its centre: corrected without knowing how targets are turned."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.bundle.state import BundleState
from photogrammetry.image_points import ImagePoints

# Three photos give nine equations for the six numbers of a disc.
_LEAST_PHOTOS = 3
# Radii follow from ellipses to a few percent.
_OTHER_SIZE = 0.15
# Image points that are worked on together: some ten arrays of nine numbers for each.
_ROWS_AT_ONCE = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Discs(ShortRepr):
    """The targets as flat discs, from the ellipses they show.

    shapes_m2 (n, 3, 3): ``radius^2 (I - normal normal^T)`` of each target in the world frame [m^2].
    known (n,): False where too few ellipses or no flat disc fits.
    """

    shapes_m2: FloatArray
    known: BoolArray

    @property
    def radius_m(self) -> FloatArray:
        """Radius of each target, shape (n,) [m]; NaN where no disc fits."""
        squares = 0.5 * np.einsum("nii->n", self.shapes_m2)
        return np.asarray(np.sqrt(np.where(self.known, squares, np.nan)))


def estimate_discs(
    observations: ImagePoints,
    ellipses_px2: FloatArray,
    state: BundleState,
    camera_of_photo: np.ndarray,
    *,
    one_size: bool = False,
) -> Discs:
    """Find size and attitude of each target from its ellipses in all photos.

    observations: The image points.
    ellipses_px2 (m, 2, 2): Shape of each target's ellipse, ``x^T S^-1 x = 1``; NaN where it has none [px^2].
    state: The adjusted network.
    one_size: Whether all targets are equally large: then the size is the median of those seen in three photos and
        more, and two photos are enough for the attitude of the others; what shows a size 15 % off keeps its own.

    A disc small against its distance shows the ellipse ``S = J M J^T`` with J the derivative of pixels by world
    coordinates and ``M = r^2 (I - n n^T)``: linear in M, three equations for each photo. The radius needs not be
    known.
    """
    n = len(observations.targets)
    normal, right, rays = np.zeros((n, 6, 6)), np.zeros((n, 6)), np.zeros(n, dtype=np.intp)
    measured = np.asarray(np.isfinite(ellipses_px2).all(axis=(1, 2)))
    for rows, camera in _blocks(measured, observations, camera_of_photo):
        targets, photos = observations.target_index[rows], observations.photo_index[rows]
        rotations = state.rotations[photos]
        centers = _in_cameras(state, photos, targets)
        jacobian = state.cameras[camera].project_with_jacobians(centers)[1] @ rotations
        design = np.stack([_row(jacobian, 0, 0), _row(jacobian, 1, 1), _row(jacobian, 0, 1)], axis=1)
        seen = np.stack([ellipses_px2[rows, 0, 0], ellipses_px2[rows, 1, 1], ellipses_px2[rows, 0, 1]], axis=1)
        # Ellipses are measured to a share of their size.
        weight = 1 / np.maximum(np.trace(ellipses_px2[rows], axis1=1, axis2=2), 1e-300)[:, None]
        design, seen = design * weight[:, :, None], seen * weight
        np.add.at(normal, targets, np.swapaxes(design, 1, 2) @ design)
        np.add.at(right, targets, np.einsum("mra,mr->ma", design, seen))
        np.add.at(rays, targets, 1)
    free = _discs(normal, right, rays)
    if not one_size or not free.known.any():
        return free
    # The same three equations for each photo, and trace M = 2 r^2 with ten times the weight of all of them.
    square = float(np.median(0.5 * np.einsum("nii->n", free.shapes_m2[free.known])))
    weight = 10 * np.einsum("nii->n", normal)[:, None]
    trace = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    sized = _discs(
        normal + weight[:, :, None] * np.outer(trace, trace), right + weight * 2 * square * trace, rays, least_photos=2
    )
    shapes = sized.shapes_m2 * _to_size(sized, square)[:, None, None]
    # What shows another size by itself is no target of that size, whatever was said.
    own = free.known & (np.abs(free.radius_m / np.sqrt(square) - 1) > _OTHER_SIZE)
    return Discs(np.where(own[:, None, None], free.shapes_m2, shapes), sized.known | own)


def _to_size(discs: Discs, square: float) -> FloatArray:
    """Return the factors that make all discs equally large, (n,)."""
    own = 0.5 * np.einsum("nii->n", discs.shapes_m2)
    return np.asarray(np.where(discs.known, square / np.where(discs.known, own, 1.0), 1.0))


def _row(jacobian: FloatArray, i: int, j: int) -> FloatArray:
    """Return the derivative of element (i, j) of J M J^T by xx, yy, zz, xy, xz, yz of M, (m, 6)."""
    a, b = jacobian[:, i], jacobian[:, j]
    mixed = [a[:, k] * b[:, m] + a[:, m] * b[:, k] for k, m in ((0, 1), (0, 2), (1, 2))]
    return np.column_stack([a * b, *mixed])


def _discs(normal: FloatArray, right: FloatArray, rays: np.ndarray, *, least_photos: int = _LEAST_PHOTOS) -> Discs:
    n = len(rays)
    shapes, known = np.zeros((n, 3, 3)), np.zeros(n, dtype=np.bool_)
    # A network that fell apart has targets before no camera.
    finite = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    seen = np.nonzero((rays >= least_photos) & finite)[0]
    # The least of all solutions where a photo's equations repeat another one's.
    values = (np.linalg.pinv(normal[seen], rcond=1e-10, hermitian=True) @ right[seen, :, None])[..., 0]
    xx, yy, zz, xy, xz, yz = values.T
    matrices = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    eigenvalues, vectors = np.linalg.eigh(matrices)
    smallest, middle, largest = eigenvalues.T
    # A flat round disc has the eigenvalues 0, r^2, r^2.
    flat = (middle > 0.6 * largest) & (np.abs(smallest) < 0.35 * largest)
    axis = vectors[flat, :, 0]
    square = 0.5 * (middle + largest)[flat]
    shapes[seen[flat]] = square[:, None, None] * (np.eye(3) - axis[:, :, None] * axis[:, None, :])
    known[seen[flat]] = True
    return Discs(shapes, known)


def eccentricities_px(
    observations: ImagePoints, discs: Discs, state: BundleState, camera_of_photo: np.ndarray
) -> FloatArray:
    """Return centre of the ellipse minus image of the centre, for each image point; 0 where the disc is not known.

    discs: Size and attitude of the targets.
    state: The adjusted network.
    Returns (m, 2): To be subtracted from measured centres [px].

    The image of the disc has the dual conic ``R M R^T - P P^T`` (P the centre in the camera's frame), whose last
    column is its centre, exact for any size.
    """
    shift = np.zeros((observations.n, 2))
    for rows, camera in _blocks(discs.known[observations.target_index], observations, camera_of_photo):
        targets, photos = observations.target_index[rows], observations.photo_index[rows]
        rotations, lens = state.rotations[photos], state.cameras[camera]
        center = _in_cameras(state, photos, targets)
        turned = rotations @ discs.shapes_m2[targets] @ np.swapaxes(rotations, 1, 2)
        dual = turned - center[:, :, None] * center[:, None, :]
        shift[rows] = lens.project(dual[:, :, 2] / dual[:, 2:, 2]) - lens.project(center)
    return shift


def _blocks(
    which: BoolArray, observations: ImagePoints, camera_of_photo: np.ndarray
) -> Iterator[tuple[np.ndarray, int]]:
    """Yield rows of one camera each, some thousands at a time, and the camera."""
    camera = np.asarray(camera_of_photo)[observations.photo_index]
    for one in np.unique(camera[which]).tolist():
        rows = np.nonzero(which & (camera == one))[0]
        for first in range(0, rows.size, _ROWS_AT_ONCE):
            yield rows[first : first + _ROWS_AT_ONCE], int(one)


def _in_cameras(state: BundleState, photos: np.ndarray, targets: np.ndarray) -> FloatArray:
    """Return targets in the frames of their photos' cameras, shape (m, 3) [m]."""
    turned = np.einsum("mij,mj->mi", state.rotations[photos], state.points_m[targets])
    return np.asarray(turned + state.translations_m[photos])
