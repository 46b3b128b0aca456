"""Pose of a mirror from its outline, known points and a measured distance, in one adjustment.

The observations are edge points along all sides, each measured across the side only. They are weighted by how well
they fit among themselves, so that a distance measured with its own sigma takes exactly its share.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from deflectometry.pose.lens_check import check_lens
from deflectometry.pose.mirror_outline import lit_share
from deflectometry.pose.mirrors_in_image import find_mirrors
from deflectometry.pose.outline_edges import (
    OutlineEdges,
    OutlineFit,
    OutlineSearch,
    correlation_points,
    edge_margin_px,
    robust_step,
)
from deflectometry.pose.pose_observations import DistanceObservation, Knowledge, KnownPoints, UncertainPose
from deflectometry.pose.start_poses import mirror_regions, point_poses, start_poses
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import principal_steps
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.adjust.least_squares import POSE, POSE_NAMES, Options, Problem, Solution, solve
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze

#: Below this probability of so large a disagreement the distance and the image are reported as contradicting.
MIN_PROBABILITY = 0.01
#: Edge residuals above this share of the mirror's size in the image are no pose: 6 mm on a 1.2 m facet. (In a small
#: image a fifth of the edges' width is allowed: a disc taken for a square of 80 px leaves half a width.)
MAX_RESIDUAL_SHARE = 0.005
#: A distance this many times longer or shorter than in the image is another unit or another thing, not an error.
MAX_DISTANCE_RATIO = 1.5
_DISTANCE_REMEDY = "check the distance, its point, the size of the mirror and the camera's focal length"
#: Fewer edge points than this share of those expected, and the outline was not found.
MIN_POINT_SHARE = 0.4
#: More rejected edge points than this share are reported: clips and stains on the reference facet take 8 %.
MAX_REJECTED_SHARE = 0.2
#: Profiles one pixel apart share pixels through the interpolation: so many neighbours err together at least.
_SHARED_POINTS = 1.5
#: A facet with less than this share lit is reported.
MIN_LIT_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class DistanceTest:
    """Whether a measured distance agrees with the image.

    image_only_m, sigma_image_only_m: What the image alone says, with sigma; NaN where it does not determine the
        distance [m].
    residual_m: Distance of the final pose less the measured one [m].
    probability: Probability of so large a disagreement (chi-square, one degree of freedom); NaN without an
        image-only distance.
    """

    measured_m: float
    image_only_m: float
    sigma_image_only_m: float
    residual_m: float
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPose:
    """The pose with its covariance and the evidence for it.

    cam_from_mirror: Pose of the mirror (facet or ensemble frame) in the camera frame.
    covariance (6, 6): Covariance of the steps of `RigidTransform.moved`, rotation [rad] then translation [m]; for
        the camera as given.
    residual_rms_px: RMS of the edge points' distances to the projected outline that the adjustment used [px]; of
        the known points' coordinates where there is no outline.
    image_only_rms_px: The same before the distances took part [px].
    sigma_edge_px: Spread of one edge point [px].
    correlation_points: Neighbouring edge points that err together; the covariance counts them as one.
    edge_width_px: Width of the edges in the image [px].
    n_points, n_rejected: Edge points (or known points) used and rejected.
    facet_share (n_facets,): Share of each facet that is bright in the image.
    distance_tests: One for each measured distance.
    points_px (n_points, 2): The edge points (or known points) that were used (x, y) [px].
    residuals_px (n_points, 2): Projected outline (or point) minus measured; of an edge point the part across the
        side [px].
    observations: What the pose was adjusted to.
    bright_parts: Parts that are bright in the image, fewer than facets where some are dark or gaps are not seen; None
        without an outline.
    other_tilt_rad (3,): Turn to another orientation that fits the outline as well [rad]; zero where none does.
    doubts: A distance or the lens contradicts the image, two tilts fit equally well, or facets are not seen.
    """

    cam_from_mirror: RigidTransform
    covariance: FloatArray
    residual_rms_px: float
    image_only_rms_px: float
    sigma_edge_px: float
    correlation_points: float
    edge_width_px: float
    n_points: int
    n_rejected: int
    facet_share: FloatArray
    distance_tests: tuple[DistanceTest, ...]
    points_px: FloatArray
    residuals_px: FloatArray
    observations: "PoseObservations"
    bright_parts: int | None = None
    other_tilt_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    doubts: tuple[Doubt, ...] = ()

    @property
    def mask_margin_px(self) -> float:
        """Distance from the outline within which a pixel mixes the facet with what is beside it [px]."""
        return edge_margin_px(self.edge_width_px, self.sigma_edge_px)

    @property
    def uncertain_pose(self) -> UncertainPose:
        """The pose with its covariance, which follows camera and screen."""
        return UncertainPose(self.cam_from_mirror, self.covariance, self.with_setup)

    def with_setup(self, setup: Setup) -> RigidTransform:
        """Return the pose that the same images and distances give with another camera or screen."""
        return self.observations.pose_with(setup, self.cam_from_mirror)


def pose_from_outline(
    image_dn: npt.ArrayLike,
    camera: Camera,
    facets: Sequence[Facet],
    knowledge: Knowledge | None = None,
    *,
    clutter: BoolArray | None = None,
) -> MirrorPose:
    """Find the pose of a mirror in the camera frame, from an image in which the mirror is bright.

    image_dn (h, w): Modulation of the fringes, or bright minus dark [DN].
    facets: The facets with their outlines and places; one for a single facet.
    knowledge: Measured distances, known points, expected roll.
    clutter (h, w): Where something else may be taken for an edge, or hides it.
    Returns: The pose. Which corner of a symmetric mirror is which follows from the expected roll.
    InputError: Image and camera differ in size.
    EstimationError: No mirror in view, cut by the border, or an outline that does not fit the design.

    Edge points are measured along normals of the projected outline, the pose is adjusted, and both are repeated with
    a shorter reach. Lens distortion and the curved edge of a curved mirror are in the projection. The residuals give
    the spread of an edge point (robust) and the number of neighbours that err together; both set the weights.
    """
    knowledge = knowledge or Knowledge()
    image = np.ascontiguousarray(image_dn, dtype=np.float32)
    if image.shape != (camera.height_px, camera.width_px):
        raise InputError(
            f"image_dn: the camera is for {camera.width_px} x {camera.height_px} px, the image has shape {image.shape}"
        )
    image = np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)
    found = find_mirrors(image)
    regions = mirror_regions(found, len(facets))
    starts = start_poses(camera, regions, facets, knowledge.roll_rad)
    facet_px = np.sqrt(float(np.median([region.area_px for region in regions])))
    size_px = float(np.ptp(np.concatenate([region.contour_px for region in regions]), axis=0).max())
    search = OutlineSearch(image, camera, facets, found.noise_dn, facet_px, clutter)
    fits = _followed(search, [start.cam_from_mirror for start in starts], knowledge.points)
    # A tilt that no edge fits has no residual, and is no rival.
    fits = sorted((fit for fit in fits if np.isfinite(fit.rms_px)), key=lambda fit: fit.rms_px) or fits
    best = fits[0]
    allowed_px = max(MAX_RESIDUAL_SHARE * size_px, 0.2 * best.edges.width_px)
    _check_outline(best, allowed_px)
    ambiguity, other = None, np.zeros(3)
    if len(fits) > 1 and _fits_outline(fits[1], allowed_px):
        chosen, ambiguity = _resolve_tilt(best, fits[1], camera, len(facets), knowledge)
        if ambiguity is not None:
            rival = fits[1] if chosen is best else best
            turn = rival.pose.rotation @ chosen.pose.rotation.T
            other = RigidTransform(turn, np.zeros(3)).rotation_vector_rad
        best = chosen
    pose = _finish(best, camera, knowledge, lit_share(camera, best.pose, facets, image > found.level_dn))
    _check_distance(pose, allowed_px)
    doubts = gather_doubts(ambiguity, pose.doubts)
    return replace(pose, bright_parts=len(found.regions), other_tilt_rad=other, doubts=doubts)


def _followed(search: OutlineSearch, starts: Sequence[RigidTransform], points: KnownPoints) -> list[OutlineFit]:
    """Follow the outline from each start; one that loses it is no rival of another.

    EstimationError: All lose it.
    """
    fits: list[OutlineFit] = []
    for number, start in enumerate(starts, start=1):
        try:
            fits.append(search.follow(start, points))
        except EstimationError:
            if number == len(starts) and not fits:
                raise
    return fits


def _check_distance(pose: MirrorPose, allowed_px: float) -> None:
    """Refuse a pose that a contradicting distance has pulled off the outline."""
    said = "; ".join(_contradiction(test) for test in pose.distance_tests if test.probability < MIN_PROBABILITY)
    if not said or pose.residual_rms_px <= allowed_px:
        return
    raise EstimationError(
        f"{said}. The pose in between misses the outline by {pose.residual_rms_px:.2f} px RMS where {allowed_px:.2f} px"
        f" are allowed (the image alone: {pose.image_only_rms_px:.3f} px); {_DISTANCE_REMEDY}"
    )


def _contradiction(test: DistanceTest) -> str:
    return (
        f"the measured distance {test.measured_m:.4f} m contradicts the image, which gives {test.image_only_m:.4f} m"
        f" (sigma {1e3 * test.sigma_image_only_m:.1f} mm)"
    )


def _fits_outline(fit: OutlineFit, allowed_px: float) -> bool:
    return bool(fit.used.sum() >= MIN_POINT_SHARE * fit.edges.n_expected and fit.rms_px <= allowed_px)


def _check_outline(best: OutlineFit, allowed_px: float) -> None:
    if not _fits_outline(best, allowed_px):
        n_used = int(best.used.sum())
        raise EstimationError(
            f"the outline in the image does not fit the mirror's outline: {n_used} of {best.edges.n_expected} edge"
            f" points fit, with a residual of {best.rms_px:.2f} px where {allowed_px:.2f} px are allowed; check"
            " outline_m, the camera's focal length, and that nothing covers the mirror, or give the pose in"
            " [mirror.pose]"
        )


def _resolve_tilt(
    best: OutlineFit, other: OutlineFit, camera: Camera, count: int, knowledge: Knowledge
) -> tuple[OutlineFit, Doubt | None]:
    """Choose between the two tilts in which a flat object looks alike, of so many facets; a doubt where both fit."""
    normals = [fit.pose.rotation[:, 2] for fit in (best, other)]
    angle_rad = float(np.arccos(np.clip(normals[0] @ normals[1], -1, 1)))
    outline = _alone(_observed_outline(best, camera, knowledge), best.edges, camera, best.pose)
    # What scatters about the rigid ensemble may be places of which nobody says how well they are known.
    scatter_m = best.rms_px * float(np.linalg.norm(best.pose.translation_m)) / camera.focal_x_px
    stated = knowledge.sigma_places_m or (None,) * count
    places = [np.full(3, scatter_m) if one is None else one for one in stated]
    misfits = [_misfit(outline, camera, fit.pose, places, knowledge.points) for fit in (best, other)]
    if misfits[1] < misfits[0]:
        best, other = other, best
    # From a mirror that faces the camera noise makes two tilts, and the truth is between them.
    between = _misfit(outline, camera, _halfway(best.pose, other.pose), places, knowledge.points)
    # Difference of chi-square if the better one is right; 9 is three sigma.
    if angle_rad < 1e-3 or min(max(misfits), between) - min(misfits) > 9.0:
        return best, None
    chosen = best
    if knowledge.distances:
        # The mirror is seen to reflect the screen: the right normal points between camera and screen.
        chosen = min((best, other), key=lambda fit: _off_bisector(fit.pose, knowledge.distances[0]))
    doubt = Doubt(
        "mirror_tilt_ambiguous",
        f"two tilts of the mirror, {np.degrees(angle_rad):.2f} degrees apart, fit its outline equally well (residuals"
        f" {best.rms_px:.3f} and {other.rms_px:.3f} px); "
        + (
            "the one that reflects the screen's middle into the camera was taken"
            if knowledge.distances
            else "the one that fits better was taken: measure a distance or a known point off the plane to be sure"
        ),
        {"apart_rad": angle_rad, "residual_rms_px": best.rms_px, "other_residual_rms_px": other.rms_px},
    )
    return chosen, doubt


def _misfit(
    outline: "_Outline", camera: Camera, pose: RigidTransform, places_m: Sequence[FloatArray], known: KnownPoints
) -> float:
    """Return the least chi-square of edges and known points at a tilt, each facet free within its sigma of place.

    places_m (3,): Sigma of the place of each facet along the axes of the ensemble; of one alone the pose is its place.

    Edges of a facet that is beside its place are all off together: counted by themselves, a millimetre of each of nine
    facets at 200 m told two tilts 70 mrad apart from each other with 8 sigma.
    """
    rows = outline.rows(camera, pose)
    edges = np.column_stack([rows.residuals, rows.derivatives])
    points = np.column_stack(known.rows(camera, pose))
    normal = edges.T @ edges + points.T @ points
    if len(places_m) > 1:
        for number, sigma_m in enumerate(places_m):
            own = edges[rows.facet == number]
            by_place = own[:, 4:] @ pose.rotation * sigma_m
            seen = by_place.T @ own
            normal -= seen.T @ np.linalg.solve(np.eye(3) + by_place.T @ by_place, seen)
    # Its turn in its plane and its place (columns) give way to the edges; its tilt does not.
    free = np.zeros((6, 4))
    free[:3, 0], free[3:, 1:] = pose.rotation[:, 2], np.eye(3)
    against = free.T @ normal[1:, 0]
    step = np.linalg.lstsq(free.T @ normal[1:, 1:] @ free, against, rcond=1e-13)[0]
    return float(normal[0, 0] - against @ step)


def _halfway(first: RigidTransform, second: RigidTransform) -> RigidTransform:
    turn = RigidTransform(second.rotation @ first.rotation.T, np.zeros(3)).rotation_vector_rad
    return first.moved(0.5 * np.concatenate([turn, second.translation_m - first.translation_m]))


def _off_bisector(pose: RigidTransform, distance: DistanceObservation) -> float:
    point = pose.apply(distance.mirror_point_m)
    to_screen = distance.cam_point_m - point
    bisector = to_screen / np.linalg.norm(to_screen) - point / np.linalg.norm(point)
    return -float(bisector @ pose.rotation[:, 2])


def _finish(best: OutlineFit, camera: Camera, knowledge: Knowledge, share: FloatArray) -> MirrorPose:
    """Adjust with everything, each edge point counted for its independent share.

    Which points are rejected was decided by the image alone: a contradicting distance must not hide behind them.
    """
    outline = _observed_outline(best, camera, knowledge)
    observations = PoseObservations(outline, knowledge.points, knowledge.distances, best.edges)
    edges = outline.edges
    # Facets that are beside their places are no fault of the lens.
    beside_m = knowledge.beside_m[edges.facet_of_side] if knowledge.sigma_places_m else 0.0
    side_px = np.hypot(outline.sigma_side_px, beside_m * edges.pixels_per_metre(camera, best.pose))
    image_only = observations.image_only().adjust(camera, best.pose).require("mirror pose")
    final = image_only
    if knowledge.distances:
        _refuse_other_unit(knowledge.distances, image_only.state)
        final = observations.adjust(camera, image_only.state).require("mirror pose")
    rms = [float(np.sqrt((edges.rows(camera, pose)[0] ** 2).mean())) for pose in (image_only.state, final.state)]
    tests = tuple(
        _test_distance(distance, camera, observations, image_only, final.state) for distance in knowledge.distances
    )
    agreeing = tuple(
        one for one, test in zip(knowledge.distances, tests, strict=True) if test.probability >= MIN_PROBABILITY
    )
    n_rejected = int((~best.used).sum())
    rejected = None
    if n_rejected > MAX_REJECTED_SHARE * best.used.size:
        rejected = Doubt(
            "outline_points_rejected",
            f"{n_rejected} of {best.used.size} edge points do not lie on the outline that the others agree on; is"
            " outline_m right, or a part of the mirror covered or dark?",
            {"rejected_count": n_rejected, "edge_points_count": best.used.size},
        )
    return MirrorPose(
        cam_from_mirror=final.state,
        covariance=final.covariance + _in_doubt(tests, image_only.state, final.state),
        residual_rms_px=rms[1],
        image_only_rms_px=rms[0],
        sigma_edge_px=best.sigma_px,
        correlation_points=best.correlation_points,
        edge_width_px=edges.width_px,
        n_points=int(best.used.sum()),
        n_rejected=n_rejected,
        facet_share=freeze(share),
        distance_tests=tests,
        points_px=freeze(edges.image_px),
        residuals_px=freeze(edges.rows(camera, final.state)[0][:, None] * edges.normals),
        observations=observations,
        doubts=gather_doubts(
            _doubts(tests, share, rms), rejected, check_lens(edges, camera, image_only.state, side_px, agreeing)
        ),
    )


def observed(fit: OutlineFit, camera: Camera, knowledge: Knowledge) -> "PoseObservations":
    """Return what a pose is adjusted to: the edges of a fit, each counted for its independent share, and the rest."""
    return PoseObservations(_observed_outline(fit, camera, knowledge), knowledge.points, knowledge.distances, fit.edges)


def _observed_outline(fit: OutlineFit, camera: Camera, knowledge: Knowledge) -> "_Outline":
    edges = fit.edges.subset(fit.used)
    sigma_px = fit.sigma_px * float(np.sqrt(fit.correlation_points))
    side_px = np.hypot(
        knowledge.side_share * edges.width_px, knowledge.sigma_outline_m * edges.pixels_per_metre(camera, fit.pose)
    )
    return _Outline(edges, sigma_px, side_px)


@dataclass(frozen=True, slots=True, eq=False)
class OutlineRows:
    """Distances of edge points from the outline, and how they follow the pose.

    residuals (n,), derivatives (n, 6): In sigma, with what a side has in common taken into account.
    facet (n,): Number of the facet that each belongs to.
    """

    residuals: FloatArray
    derivatives: FloatArray
    facet: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Outline:
    """Edge points with the sigma of each and of each side."""

    edges: OutlineEdges
    sigma_px: float
    sigma_side_px: FloatArray

    def rows(self, camera: Camera, pose: RigidTransform) -> OutlineRows:
        """Return the edge points in sigma."""
        rows = self.edges.whitened(camera, pose, self.sigma_px, self.sigma_side_px)
        return OutlineRows(*rows, self.edges.facet_of_side[self.edges.place[:, 0]])


def _alone(outline: _Outline, measured: OutlineEdges, camera: Camera, pose: RigidTransform) -> _Outline:
    """Return the edge points that belong to each facet by itself, with the sigma of their own scatter.

    Of a facet that is beside its place the ensemble's pose rejects edges, or the half of each side that suits it, and
    the scatter of edges about the rigid ensemble has the facets' misplacement in it.
    """
    residuals, derivatives = measured.rows(camera, pose)
    facet = measured.facet_of_side[measured.place[:, 0]]
    used, left = np.zeros(facet.size, dtype=np.bool_), np.array(residuals)
    nothing = np.zeros(0), np.zeros((0, 6))
    for number in np.unique(facet):
        on = facet == number
        found = robust_step(residuals[on], derivatives[on], nothing, measured.floor_px)
        used[on] = found.weights > 0
        left[on] += derivatives[on] @ found.step
    scatter_px = max(robust_scale(left[used], upper=True), measured.floor_px)
    together = correlation_points(measured.along_sides(np.where(used, left, np.nan)))
    sigma_px = scatter_px * float(np.sqrt(max(together, _SHARED_POINTS)))
    return _Outline(measured.subset(used), sigma_px, outline.sigma_side_px)


@dataclass(frozen=True, slots=True, eq=False)
class PoseObservations:
    """What a pose is adjusted to; kept, because the pose follows when camera or screen stand elsewhere.

    outline: Edge points, where there is an outline.
    points: Known points.
    distances: Distances to the origin of the screen.
    measured: All edge points, also those that are not on the outline of the ensemble.
    """

    outline: _Outline | None
    points: KnownPoints
    distances: tuple[DistanceObservation, ...]
    measured: OutlineEdges | None = None

    def image_only(self) -> "PoseObservations":
        """Return the observations without the distances."""
        return replace(self, distances=())

    def adjust(self, camera: Camera, start: RigidTransform) -> Solution[RigidTransform]:
        """Find the pose that fits best."""

        def evaluate(pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
            residuals, derivatives = self.points.rows(camera, pose)
            if self.outline is None:
                return residuals, derivatives
            outline = self.outline
            across, d_across = outline.edges.whitened(camera, pose, outline.sigma_px, outline.sigma_side_px)
            return np.concatenate([across, residuals]), np.concatenate([d_across, derivatives])

        extra = tuple(distance.constraint() for distance in self.distances)
        # A ten-thousandth of a sigma is enough; iterating to round-off doubles the time. A tilt acts by its square on
        # a far mirror that faces the camera, which linear steps do not know: where a distance presses it there, drawn
        # mirrors at 200 m took up to 356.
        options = Options(max_iterations=5000, tolerance=1e-4)
        return solve(Problem(POSE_NAMES, evaluate, POSE, extra=extra), start, options=options)

    def outline_rows(self, camera: Camera, pose: RigidTransform) -> OutlineRows:
        """Return the edge points that a pose is adjusted to; none where there is no outline."""
        if self.outline is None:
            return OutlineRows(np.zeros(0), np.zeros((0, 6)), np.zeros(0, dtype=np.intp))
        return self.outline.rows(camera, pose)

    def rows_of_facets(self, camera: Camera, pose: RigidTransform) -> OutlineRows:
        """Return the edge points that belong to each facet by itself, wherever it is, in sigma of their own scatter."""
        if self.measured is None or self.outline is None:
            return self.outline_rows(camera, pose)
        return _alone(self.outline, self.measured, camera, pose).rows(camera, pose)

    def pose_with(self, setup: Setup, start: RigidTransform) -> RigidTransform:
        """Return the pose that the same observations give with another camera, or with the screen elsewhere."""
        origin_m = setup.cam_from_screen.translation_m
        distances = tuple(replace(one, cam_point_m=origin_m) for one in self.distances)
        return replace(self, distances=distances).adjust(setup.camera, start).require("mirror pose").state


def _test_distance(
    distance: DistanceObservation,
    camera: Camera,
    observations: PoseObservations,
    image_only: Solution[RigidTransform],
    final: RigidTransform,
) -> DistanceTest:
    """Compare a distance with what the image says, whose focal length is known as well as the camera is.

    At 200 m a focal length known to 0.3 permille is 66 mm: as much as everything else, or more.
    """
    predicted, derivatives = distance.predict(image_only.state)
    variance = float(derivatives @ image_only.covariance @ derivatives)
    alone = observations.image_only()
    for step in principal_steps(camera.covariance):
        other = alone.adjust(camera.with_parameters(camera.parameters + step), image_only.state).state
        variance += (distance.predict(other)[0] - predicted) ** 2
    square = (predicted - distance.distance_m) ** 2 / (variance + distance.sigma_m**2)
    return DistanceTest(
        measured_m=distance.distance_m,
        image_only_m=predicted,
        sigma_image_only_m=float(np.sqrt(variance)),
        residual_m=distance.predict(final)[0] - distance.distance_m,
        probability=1.0 - chi_square_cdf(square, 1.0),
    )


def _refuse_other_unit(distances: Sequence[DistanceObservation], image_only: RigidTransform) -> None:
    """Refuse a distance that no adjustment can reconcile: a number in another unit, or a length in one."""
    for distance in distances:
        seen_m = distance.predict(image_only)[0]
        if not 1 / MAX_DISTANCE_RATIO < distance.distance_m / seen_m < MAX_DISTANCE_RATIO:
            raise EstimationError(
                f"the measured distance {distance.distance_m:g} m is {distance.distance_m / seen_m:.3g} times the"
                f" {seen_m:.4g} m that the image says; are distance_m, outline_m and the screen's translation_m all in"
                " metres, and is the camera's focal length right?"
            )


def _in_doubt(tests: Sequence[DistanceTest], image_only: RigidTransform, final: RigidTransform) -> FloatArray:
    """Return the covariance of not knowing which is right: the step from the image's pose to the adjusted one."""
    if all(test.probability >= MIN_PROBABILITY for test in tests):
        return np.zeros((6, 6))
    turn = RigidTransform(final.rotation @ image_only.rotation.T, np.zeros(3)).rotation_vector_rad
    step = np.concatenate([turn, final.translation_m - image_only.translation_m])
    return np.outer(step, step)


def _doubts(tests: tuple[DistanceTest, ...], share: FloatArray, rms_px: Sequence[float]) -> Iterator[Doubt]:
    """Yield what distances contradict and which facets are not seen."""
    for test in tests:
        if test.probability < MIN_PROBABILITY:
            yield Doubt(
                "distance_contradicts_image",
                f"{_contradiction(test)}: probability {test.probability:.2g}. The pose in between leaves"
                f" {1e3 * test.residual_m:.1f} mm and {rms_px[1]:.3f} px (the image alone: {rms_px[0]:.3f} px); the way"
                f" from one to the other counts as uncertainty; {_DISTANCE_REMEDY}",
                {
                    "measured_m": test.measured_m,
                    "image_only_m": test.image_only_m,
                    "sigma_image_only_m": test.sigma_image_only_m,
                    "agreement_probability": test.probability,
                },
            )
    unseen = np.flatnonzero(share < MIN_LIT_SHARE)
    if unseen.size:
        yield Doubt(
            "facets_dark",
            f"{unseen.size} of {share.size} facets are bright on less than {MIN_LIT_SHARE:.0%} of their area (numbers"
            f" {', '.join(map(str, unseen[:12]))}): they are dark, covered, missing, or see past the screen",
            {"dark_count": unseen.size, "facets_count": share.size},
        )


def pose_from_points(camera: Camera, knowledge: Knowledge) -> MirrorPose:
    """Find the pose from known points alone, with measured distances where there are any.

    knowledge: At least four known points.
    Returns: The pose; what concerns edges is NaN.
    EstimationError: The points do not determine the pose, or do not fit within their sigmas by far.
    """
    points = knowledge.points
    starts = point_poses(camera, points.points_m, points.image_px)
    observations = PoseObservations(None, points, knowledge.distances)
    solutions = [observations.image_only().adjust(camera, start.cam_from_mirror) for start in starts]
    image_only = min(solutions, key=lambda solution: float(solution.residuals @ solution.residuals))
    image_only = image_only.require("mirror pose from known points")
    final = image_only
    if knowledge.distances:
        _refuse_other_unit(knowledge.distances, image_only.state)
        final = observations.adjust(camera, image_only.state).require("mirror pose")
    rms = [_points_rms(camera, points, solution.state) for solution in (image_only, final)]
    # 6 sigma for every point at once is no bad luck.
    if image_only.redundancy and image_only.variance_factor > 36.0:
        raise EstimationError(
            f"the known points miss their places in the image by {rms[0]:.2f} px,"
            f" {np.sqrt(image_only.variance_factor):.0f} times what their sigmas allow; check coordinates, order and"
            " the camera"
        )
    tests = tuple(
        _test_distance(distance, camera, observations, image_only, final.state) for distance in knowledge.distances
    )
    nan = float("nan")
    misses = freeze(camera.project(final.state.apply(points.points_m)) - points.image_px)
    count = len(points.points_m)
    return MirrorPose(
        final.state,
        final.covariance,
        rms[1],
        rms[0],
        nan,
        1.0,
        nan,
        count,
        0,
        np.zeros(0),
        tests,
        points.image_px,
        misses,
        observations,
        doubts=tuple(_doubts(tests, np.ones(1), rms)),
    )


def _points_rms(camera: Camera, points: KnownPoints, pose: RigidTransform) -> float:
    return float(np.sqrt(((camera.project(pose.apply(points.points_m)) - points.image_px) ** 2).mean()))
