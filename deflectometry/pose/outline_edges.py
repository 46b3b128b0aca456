"""Follow the outline of known facets in an image: measure edge points, move the pose, measure again."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deflectometry.pose.mirror_outline import OutlinePoints, beside_another, project_outline, sample_outlines
from deflectometry.pose.mirrors_in_image import measure_edges
from deflectometry.pose.pose_observations import KnownPoints
from heliogauge.adjust.robust_loss import Cauchy, Tukey
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray

#: Search ranges of the passes, as a share of a facet's size: a polygon around pixels is off by a few per cent at most.
_REACHES = (0.06, 0.03, 0.02)


@dataclass(frozen=True, slots=True, eq=False)
class OutlineEdges:
    """Edge points in the image, each with the point of the outline that it belongs to.

    points_m (n, 3): Points of the outline in the mirror's frame [m].
    image_px (n, 2): Where the edge was measured [px].
    normals (n, 2): The direction in which it was measured.
    place (n, 2): Number of the side and of the point along it.
    points_per_side: Points along each side, found or not.
    facet_of_side, expected_on_side (sides,): Facet that each side belongs to, and how many points could be found on
        it.
    width_px: Width of the edges [px].
    floor_px: Spread of one point from the image noise alone [px].
    """

    points_m: FloatArray
    image_px: FloatArray
    normals: FloatArray
    place: IntArray
    points_per_side: int
    facet_of_side: IntArray
    expected_on_side: IntArray
    width_px: float
    floor_px: float

    @property
    def n_expected(self) -> int:
        """How many points could be found."""
        return int(self.expected_on_side.sum())

    def subset(self, chosen: BoolArray) -> "OutlineEdges":
        """Return the edges with only some of the points."""
        return OutlineEdges(
            self.points_m[chosen],
            self.image_px[chosen],
            self.normals[chosen],
            self.place[chosen],
            self.points_per_side,
            self.facet_of_side,
            self.expected_on_side,
            self.width_px,
            self.floor_px,
        )

    def rows(self, camera: Camera, pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
        """Return the distances of the projected outline from the edge points, (n,) [px], and derivatives (n, 6)."""
        projection = camera.project_posed(self.points_m, pose)
        residuals = ((projection.pixels_px - self.image_px) * self.normals).sum(axis=1)
        return residuals, np.einsum("ni,nij->nj", self.normals, projection.d_pixel_d_pose)

    def whitened(
        self, camera: Camera, pose: RigidTransform, sigma_px: float, sigma_side_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the rows divided by the root of their covariance, ``sigma^2 I + sigma_side^2`` within each side.

        pose: cam_from_mirror.
        sigma_px: Standard deviation of each point on its own [px].
        sigma_side_px (sides,): Standard deviation of what all points of one side have in common [px].
        Returns: Residuals (n,) and derivatives (n, 6), in sigma.
        """
        residuals, derivatives = self.rows(camera, pose)
        rows = np.column_stack([residuals, derivatives]) / sigma_px
        side, n_sides = self.place[:, 0], self.facet_of_side.size
        count = np.bincount(side, minlength=n_sides)
        # The root of the inverse takes this share of its mean off each side.
        share = 1 - 1 / np.sqrt(1 + count * (sigma_side_px / sigma_px) ** 2)
        sums = np.zeros((n_sides, rows.shape[1]))
        np.add.at(sums, side, rows)
        rows -= (sums * (share / np.maximum(count, 1))[:, None])[side]
        return rows[:, 0], rows[:, 1:]

    def pixels_per_metre(self, camera: Camera, pose: RigidTransform) -> FloatArray:
        """Return the scale of the image at each side, shape (sides,) [px/m]."""
        distance = np.linalg.norm(pose.apply(self.points_m), axis=1)
        side, n_sides = self.place[:, 0], self.facet_of_side.size
        mean = np.bincount(side, distance, n_sides) / np.maximum(np.bincount(side, minlength=n_sides), 1)
        return np.asarray(camera.focal_x_px / np.where(mean > 0, mean, np.inf))

    def along_sides(self, values: FloatArray) -> FloatArray:
        """Spread values of the points over (sides, points per side), NaN where there is none."""
        spread = np.full((self.facet_of_side.size, self.points_per_side), np.nan)
        spread[self.place[:, 0], self.place[:, 1]] = values
        return spread


@dataclass(frozen=True, slots=True, eq=False)
class OutlineFit:
    """A pose that follows the outline, from the image (and known points) alone.

    pose: cam_from_mirror.
    edges: The edge points of the last pass.
    used (n,): Points that belong to the outline.
    sigma_px: Spread of one used point [px].
    correlation_points: Neighbours that err together.
    """

    pose: RigidTransform
    edges: OutlineEdges
    used: BoolArray
    sigma_px: float
    rms_px: float
    correlation_points: float


@dataclass(frozen=True, slots=True, eq=False)
class OutlineSearch:
    """An image and the facets to follow in it.

    image_dn (h, w): The image [DN].
    noise_dn: Noise of one pixel [DN].
    facet_px: Size of a facet in the image [px].
    clutter (h, w): Where something else may be taken for an edge, or hides it; None: nowhere.
    """

    image_dn: Float32Array
    camera: Camera
    facets: Sequence[Facet]
    noise_dn: float
    facet_px: float
    clutter: BoolArray | None = None

    def follow(self, pose: RigidTransform, points: KnownPoints) -> OutlineFit:
        """Move a pose until the projected outline lies on the edges.

        points: Known points that take part.
        EstimationError: Hardly any edge along the expected outline.
        """
        width: float | None = None
        for number, reach in enumerate(_REACHES):
            # The first passes only have to come near.
            coarse = number < len(_REACHES) - 2
            outline = sample_outlines(self.facets, 32 if coarse else round(self.facet_px))
            edges = self._measure(pose, outline, max(reach * self.facet_px, 1.5), width, avoid=not coarse)
            width = edges.width_px
            residuals, derivatives = edges.rows(self.camera, pose)
            known = points.rows(self.camera, pose)
            step, weights, sigma = robust_step(residuals, derivatives, known, edges.floor_px)
            pose = pose.moved(step)
        residuals = edges.rows(self.camera, pose)[0]
        used = weights > 0
        series = edges.along_sides(np.where(used, residuals, np.nan))
        rms = float(np.sqrt((residuals[used] ** 2).mean()))
        # Profiles one pixel apart share pixels through the interpolation, which leaves 2/3 of the variance but all of
        # the knowledge of one sample per pixel. Short series alone would put the correlation at 1.0 now and then.
        shared = 1.5 * edges.points_per_side / self.facet_px
        return OutlineFit(pose, edges, used, sigma, rms, max(correlation_points(series), shared))

    def _measure(
        self, pose: RigidTransform, outline: OutlinePoints, reach_px: float, width: float | None, *, avoid: bool
    ) -> OutlineEdges:
        """Measure the edges near an outline.

        avoid: Leave out what clutter may have moved.
        """
        corner_reach = 3.0 if width is None else width + 1.0
        projected = project_outline(self.camera, pose, outline, corner_reach)
        # A pose that has gone astray, of a photo whose sides are exchanged, say, shows nothing.
        usable = projected.usable & np.isfinite(projected.pixels_px).all(axis=-1)
        if len(self.facets) > 1:
            metres_per_px = float(np.linalg.norm(pose.translation_m)) / self.camera.focal_x_px
            usable = usable & ~beside_another(self.facets, outline, corner_reach * metres_per_px)
        pixels, normals = projected.pixels_px[usable], projected.normals[usable]
        measured = measure_edges(
            self.image_dn, pixels, normals, reach_px=reach_px, noise_dn=self.noise_dn, width_px=width
        )
        found = np.isfinite(measured.offset_px)
        expected, covered = usable.sum(axis=1), 0
        if avoid and self.clutter is not None and found.any():
            places = pixels + np.nan_to_num(measured.offset_px)[:, None] * normals
            hidden = _in_clutter(self.clutter, places, normals, measured.width_px)
            expected = expected - np.bincount(np.argwhere(usable)[hidden, 0], minlength=len(expected))
            covered = int(np.count_nonzero(found & hidden))
            found &= ~hidden
        if found.any():
            # An edge with less than half the usual step is that of something else.
            found[found] = measured.contrast_dn[found] > 0.5 * np.median(measured.contrast_dn[found])
        if found.sum() < 8:
            few = f"only {int(found.sum())} edge points of the mirror were found along its expected outline"
            if covered > found.sum():
                raise EstimationError(
                    f"{few}: dots that stand close to each other touch {covered} others; give the pose in "
                    "[mirror.pose], or use a pattern with smaller dots"
                )
            raise EstimationError(
                f"{few}; check outline_m and the camera's focal length, or give the pose in [mirror.pose]"
            )
        return OutlineEdges(
            points_m=outline.points_m[usable][found],
            image_px=pixels[found] + measured.offset_px[found][:, None] * normals[found],
            normals=normals[found],
            place=np.argwhere(usable)[found],
            points_per_side=usable.shape[1],
            facet_of_side=outline.facet_index,
            expected_on_side=expected,
            width_px=measured.width_px,
            # Half of it: the floor only keeps a perfect image from claiming sigma 0, the residuals decide otherwise.
            floor_px=0.5 * float(np.median(measured.sigma_px[found])),
        )


def _in_clutter(clutter: BoolArray, pixels_px: FloatArray, normals: FloatArray, width_px: float) -> BoolArray:
    """Return whether the profile of each edge point (n,), its edge and what is inside it, passes clutter."""
    along = np.arange(-width_px - 1.0, 0.5 * width_px, 0.5)
    column, row = np.rint(pixels_px.T[..., None] + normals.T[..., None] * along).astype(np.intp)
    height, width = clutter.shape
    return np.asarray(clutter[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].any(axis=1))


#: Windows by which edges are found widen them by this much, quadratically: on drawn edges of six kinds with a blur of
#: 0.42 to 2.5 px (standard deviation, pixel included) the widths are sqrt(2 pi blur^2 + 1.6^2) within 0.05 px.
_WINDOW_PX = 1.6
#: Beside an edge the mirror's part of what a pixel sees lies farther inside: so far at most [px].
_MOST_INWARDS_PX = 0.0065


def edge_blur_px(edge_width_px: float) -> float:
    """Return the standard deviation of the blur, pixel included, that makes edges of a width; NaN of NaN [px].

    An edge with Gaussian blur of standard deviation s has a width, height over steepest slope, of s sqrt(2 pi).
    """
    return float(np.sqrt(np.maximum(edge_width_px**2 - _WINDOW_PX**2, 0.0) / (2 * np.pi)))


def edge_margin_px(edge_width_px: float, sigma_edge_px: float) -> float:
    """Return the distance from the outline within which a pixel mixes the mirror with what is beside it.

    edge_width_px: Width of the edges; NaN where none was measured [px].
    sigma_edge_px: Spread of the edges about the outline [px].
    Returns: Half the width and a quarter of a pixel more, half a pixel's diagonal at least, and with more blur as far
        as what is seen lies less than 0.0065 px inwards [px].

    A pixel that lacks 5 % of its light on one side sees the screen 0.05 px off, which is 0.08 mrad on a facet of 85 px;
    beyond this distance the error is below 1.3 sigma of the noise (synthetic facets, blur 0.1 to 0.4 px). At z sigma
    of the blur from the edge the mean of what is seen lies phi(z) sigma inwards (phi the normal density); half the
    width is 1.3 sigma, from where a blur of 1.4 px made 7.6 sigma of a facet's curvature.
    """
    width = np.nan_to_num(edge_width_px)
    blur = edge_blur_px(width)
    clear = blur * np.sqrt(2 * np.log(max(blur / (_MOST_INWARDS_PX * np.sqrt(2 * np.pi)), 1.0)))
    reach = max(0.5 * np.sqrt(2), 0.5 * width + 0.25, clear)
    return float(reach + np.nan_to_num(sigma_edge_px))


class RobustStep(NamedTuple):
    """A step of the pose (6,) for `RigidTransform.moved`, the edge points' weights (n,) and their spread [px]."""

    step: FloatArray
    weights: FloatArray
    sigma_px: float


def robust_step(
    residuals: FloatArray, derivatives: FloatArray, known: tuple[FloatArray, FloatArray], floor_px: float
) -> RobustStep:
    """Find the step of the pose that fits most edge points, and how much they scatter.

    Shapes: derivatives (n, 6).
    residuals (n,): Distances of the edge points at the present pose [px].
    known: Whitened residuals (m,) and derivatives (m, 6) of known points, never weakened.
    floor_px: Least spread that the noise allows [px].
    Returns: The step; weights are Tukey's, 0 for rejected points.

    Linear in the step, iteratively reweighted: the caller linearises again at the new pose. Cauchy's weights, which
    drop no point, come first: at a coarse start the whole outline is off.
    """
    # Columns in their own lengths, so that radians and metres may be solved together.
    scale = np.linalg.norm(derivatives, axis=0)
    scale[scale == 0] = 1.0
    matrix, known_matrix = derivatives / scale, known[1] / scale
    left = residuals
    sigma = max(robust_scale(left, upper=True), floor_px)
    step = np.zeros(6)
    weights = np.ones(residuals.size)
    for iteration in range(30):
        weights = (Cauchy() if iteration < 6 else Tukey()).weight(left / sigma)
        weighted = matrix * (weights / sigma**2)[:, None]
        normal = weighted.T @ matrix + known_matrix.T @ known_matrix
        right = weighted.T @ residuals + known_matrix.T @ known[0]
        # A direction that nothing holds stays where it is; the final adjustment names it.
        step = -np.linalg.lstsq(normal, right, rcond=1e-13)[0]
        before, left = left, residuals + matrix @ step
        sigma = max(robust_scale(left, upper=True), floor_px)
        if iteration >= 8 and np.abs(left - before).max() < 1e-3 * sigma:
            break
    return RobustStep(step / scale, weights, sigma)


def correlation_points(series: FloatArray) -> float:
    """Return how many neighbours err together.

    series (sides, n): Residuals along each side, NaN where missing.
    Returns: Integrated correlation ``1 + 2 sum_k rho_k``, at least 1, summed until k exceeds four times it (Sokal
        1997).
    """
    valid = np.isfinite(series)
    values = np.where(valid, series, 0.0)
    power = float((values**2).sum()) / max(int(valid.sum()), 1)
    total = 1.0
    for lag in range(1, series.shape[1] // 2):
        pairs = int((valid[:, lag:] & valid[:, :-lag]).sum())
        if power == 0 or pairs < 8 or lag > 4 * total:
            break
        total = max(1.0, total + 2 * float((values[:, lag:] * values[:, :-lag]).sum()) / pairs / power)
    return total
