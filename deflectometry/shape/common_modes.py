"""The share of the uncertainty that a whole slope map has in common: pose, screen and camera."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from deflectometry.pose.facet_places import FacetPlace
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep, moved_setup, principal_steps, setup_steps
from deflectometry.shape.facet_pixels import PixelSamples, trace_samples
from deflectometry.shape.smooth_shape import FacetSamples, RoundLimits, ShapeSolution, slopes_at, solve_shape
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.map import CommonModes, monomials
from heliogauge.validate import FloatArray

#: Degree of the polynomials that hold a mode: what pose, lens and screen do to a map is smooth, a cubic leaves
#: less than 2 % of it on the setups tried.
MODE_DEGREE = 3
#: Source of the modes of the mirror's own pose; all others are of camera and screen.
MIRROR_POSE = "mirror pose"
#: Source of the modes of single facets that are not where the ensemble has them.
FACET_PLACE = "place of a facet"
#: Facets are moved by so much at most; a sigma below that of rounding is none [m].
_STEP_M, _NO_STEP_M = 2e-3, 1e-12


def common_modes(
    setup: Setup,
    samples: Sequence[PixelSamples],
    solution: ShapeSolution,
    located: UncertainPose,
    *,
    align: bool,
    places: Sequence[FacetPlace] = (),
) -> list[CommonModes]:
    """Propagate the uncertainty of pose, screen and camera into the slopes of each facet.

    solution: The shape found with the values as given.
    located: The mirror's pose.
    places: How well the place of each facet of an ensemble is known.
    align: As in `deflectometry.shape.smooth_shape.solve_shape`.
    Returns: One mode for each independent direction of each covariance, for each facet.

    Each covariance is split into its principal directions; the whole solution (shape and alignment included) is
    repeated with the input moved by one sigma along each, and the change of the slopes is fitted by a cubic. A pixel
    that then sees another point of the mirror is compared with the slope of the smooth shape there. A pose that was
    found from the image, or from a distance to the screen, follows camera and screen; what is left of its uncertainty
    is independent of theirs. (With the pose held in place, a focal length off by 0.15 % and a distance that gave way
    to it would count five times too much, a principal point in y half of its true share.)
    """

    def inputs(cam_from_mirror: RigidTransform) -> Iterator[MovedInput]:
        yield from moved_inputs(setup, cam_from_mirror, located)
        yield from moved_facets(setup, cam_from_mirror, located, places)

    return modes_of_inputs(setup, samples, solution, inputs, align=align)


def modes_of_inputs(
    setup: Setup,
    samples: Sequence[PixelSamples],
    solution: ShapeSolution,
    inputs: Callable[[RigidTransform], Iterable["MovedInput"]],
    *,
    align: bool,
) -> list[CommonModes]:
    """Return what other inputs do to the slopes of each facet: one mode for each.

    solution, align: As in `common_modes`.
    inputs: Makes them from the pose of the mirror.
    """
    as_given = trace_samples(setup, samples)

    def moved(cam_from_mirror: RigidTransform) -> Iterator[MovedSamples]:
        for one in inputs(cam_from_mirror):
            traced = [
                old if one.facets is not None and old.facet.name not in one.facets else one.sampled(sample)
                for old, sample in zip(as_given, samples, strict=True)
            ]
            yield MovedSamples(one.source, traced, one.cam_from_mirror, one.times)

    return modes_of_samples(as_given, solution, moved, align=align)


@dataclass(frozen=True, slots=True, eq=False)
class MovedSamples:
    """Lines of sight and the points seen along them with one input moved, and the name of its source.

    times: How many of these moves are one sigma; 0 for an input that is exact.
    """

    source: str
    samples: Sequence[FacetSamples]
    cam_from_mirror: RigidTransform
    times: float = 1.0


def modes_of_samples(
    samples: Sequence[FacetSamples],
    solution: ShapeSolution,
    moved: Callable[[RigidTransform], Iterable[MovedSamples]],
    *,
    align: bool,
) -> list[CommonModes]:
    """Return what other inputs do to the slopes of each facet, whatever the known points in the mirror are.

    samples: Lines of sight and the points seen along them, as given.
    solution, align: As in `common_modes`.
    moved: Makes the same with one input moved after the other, from the pose of the mirror.
    Returns: One mode for each input, for each facet.
    """
    # The base must be at rest on these very samples, or the first step would move it too.
    start = solve_shape(samples, solution.cam_from_mirror, align=align, start=solution, rounds=RoundLimits(30, 1))
    base = departures(samples, start, start)
    sources: list[str] = []
    changes: list[list[FloatArray]] = []
    rounds = RoundLimits(2, 1, must_settle=False)
    for one in moved(start.cam_from_mirror):
        if one.times == 0.0:
            sources.append(one.source)
            changes.append([np.zeros_like(before[1]) for before in base])
            continue
        shape = solve_shape(one.samples, one.cam_from_mirror, align=align, start=start, rounds=rounds)
        sources.append(one.source)
        moved_on = departures(one.samples, shape, start)
        changes.append([one.times * (after[1] - before[1]) for after, before in zip(moved_on, base, strict=True)])
    return [
        _as_modes(sources, [change[k] for change in changes], base[k][0], samples[k].facet) for k in range(len(samples))
    ]


def departures(
    samples: Sequence[FacetSamples], solution: ShapeSolution, start: ShapeSolution
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the positions of each facet's samples, and their slopes minus those of the start's shape there."""
    results = []
    for sample, surface, smooth in zip(samples, solution.surfaces, start.surfaces, strict=True):
        facet_from_cam = (solution.cam_from_mirror @ sample.facet.ensemble_from_facet).inverse()
        camera = facet_from_cam.translation_m
        points = surface.intersect(camera, facet_from_cam.rotation @ sample.rays_cam)
        screen = facet_from_cam.rotation @ sample.screen_cam_m + camera[:, None]
        slopes = np.stack(slopes_at(points, camera, screen))
        results.append((points[:2], slopes - np.stack(smooth.gradient(points[0], points[1]))))
    return results


@dataclass(frozen=True, slots=True, eq=False)
class MovedInput:
    """Inputs of which one was moved, and the name of its source.

    facets: Names of the facets whose samples it concerns; None for all.
    shift_m (3,): By how much these facets are moved in the mirror's frame [m].
    times: How many of these moves are one sigma.
    """

    source: str
    setup: Setup
    cam_from_mirror: RigidTransform
    facets: frozenset[str] | None = None
    shift_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    times: float = 1.0

    def sampled(self, sample: PixelSamples) -> FacetSamples:
        """Return the lines of sight of a facet that it concerns, and what is seen along them."""
        (traced,) = trace_samples(self.setup, [sample])
        if not self.shift_m.any():
            return traced
        place = traced.facet.ensemble_from_facet
        moved = RigidTransform(place.rotation, place.translation_m + self.shift_m)
        return replace(traced, facet=replace(traced.facet, ensemble_from_facet=moved))


def moved_inputs(setup: Setup, cam_from_mirror: RigidTransform, located: UncertainPose) -> Iterator[MovedInput]:
    """Yield the inputs moved by one sigma along each principal direction of each covariance."""
    for step in principal_steps(located.covariance):
        yield MovedInput(MIRROR_POSE, setup, cam_from_mirror.moved(step))
    for one in setup_steps(setup):
        yield moved_input(setup, cam_from_mirror, located, one)


def moved_facets(
    setup: Setup, cam_from_mirror: RigidTransform, located: UncertainPose, places: Sequence[FacetPlace]
) -> Iterator[MovedInput]:
    """Yield the facets moved one by one by the three columns of the symmetric root of what is known of their place.

    A pose that was found from the outlines follows. Other than principal directions the columns of that root belong
    together one by one when several poses of a mirror know its places alike: facets are where they are in all of them.
    """
    aligned = located.cam_from_mirror.inverse() @ cam_from_mirror
    for place in places:
        values, vectors = np.linalg.eigh(place.covariance_m2)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        for step in root.T:
            # Steps of a place that is hardly known are no small ones; what they do is proportional to them.
            length = float(np.linalg.norm(step))
            times = max(length / _STEP_M, 1.0) if length > _NO_STEP_M else 0.0
            step_m = step / max(times, 1.0)
            pose = located.cam_from_mirror.moved(place.pose_by_place @ step_m) @ aligned
            yield MovedInput(FACET_PLACE, setup, pose, frozenset({place.name}), step_m, times)


def moved_input(setup: Setup, cam_from_mirror: RigidTransform, located: UncertainPose, step: SetupStep) -> MovedInput:
    """Return the inputs after one step of camera or screen, which the pose follows."""
    moved = moved_setup(setup, (step,), np.ones(1))
    follows = located.following(moved, cam_from_mirror) if step.moves_pose else cam_from_mirror
    return MovedInput(step.source, moved, follows, step.facets)


def _as_modes(sources: list[str], changes: list[FloatArray], points_m: FloatArray, facet: Facet) -> CommonModes:
    """Fit each change of slopes by polynomials over the facet."""
    center = np.asarray(facet.reference_point_m)
    scale = 0.5 * float(np.ptp(facet.outline_m, axis=0).max())
    terms = (MODE_DEGREE + 1) * (MODE_DEGREE + 2) // 2
    usable = np.isfinite(points_m).all(axis=0)
    for change in changes:
        usable &= np.isfinite(change).all(axis=0)
    u, v = (points_m[:, usable] - center[:, None]) / scale
    matrix = monomials(u, v, MODE_DEGREE)
    solver = np.linalg.pinv(matrix @ matrix.T, rcond=1e-12, hermitian=True) @ matrix
    # Every facet keeps every mode, so that the modes of all facets belong together one by one.
    coefficients = np.array([(solver @ change[:, usable].T).T for change in changes]).reshape(-1, 2, terms)
    return CommonModes(tuple(sources), coefficients, center, scale)
