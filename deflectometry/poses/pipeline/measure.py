"""A measurement in several poses to its result: the stages follow each other in `run`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.keys import DeflectometryMeasurement
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.headline import canting_numbers, facet_numbers, joined_curl, numbers_of_maps
from deflectometry.pipeline.inputs import build_facets, build_mounts, build_setup
from deflectometry.pipeline.measure import run as measure_frames
from deflectometry.pipeline.result import Result
from deflectometry.poses.adjustment import JointSolution, adjust_poses
from deflectometry.poses.keys import PosesMeasurement
from deflectometry.poses.pipeline.result import PoseRow, PosesResult, doubts_of_setup
from deflectometry.poses.pose_maps import JointMaps, PoseMaps, combine_maps, keep_map, slopes_of_poses
from deflectometry.poses.setup_parameters import setup_parameters
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep, moved_setup, principal_steps, setup_steps
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.facet_canting import canting_of_facets, doubt_of_canting
from deflectometry.shape.smooth_shape import Align
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError, MetrologyError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import FloatArray

#: Rounds of measuring with the setup as adjusted; the second leaves less than a hundredth of what the first corrects.
_MOST_ROUNDS = 3
#: A last linear step this many sigmas long leaves, with sensitivities good to 2 %, an error of a tenth of a sigma.
_LAST_STEP_SIGMAS = 5.0
#: Below this probability the poses differ by more than noise and stated sigmas explain, and from this factor on the
#: cause matters more than the noise: drawn measurements, whose pixels are coarse and sigmas true, have 1.0 to 1.7.
_LEAST_PROBABILITY, _LEAST_FACTOR = 1e-3, 2.0


def run(measurement: PosesMeasurement, options: Options | None = None, progress: Progress | None = None) -> PosesResult:
    """Evaluate a mirror in several poses in one adjustment.

    options: Choices that override the file's.
    Returns: One map of the mirror, the parameters of camera and screen as stated and as found.
    InputError: Images or tables that cannot be used; poses without outline.
    EstimationError: Fewer than two poses that can be measured, or poses that have too little of the mirror in common.

    Each pose is measured with camera and screen as stated, one after the other, and only its maps are kept; one
    adjustment finds what camera and screen do to them; the poses are measured again with the setup that was found,
    until what is left for the linear adjustment is small.
    """
    options, progress = options or Options(), progress or SilentProgress()
    first = next(iter(measurement.poses.values()))
    stated, facets = build_setup(first), build_facets(first.model.mirror, measurement.model.name)
    if not facets:
        raise InputError(
            f"{measurement.folder / MEASUREMENT_FILE}: poses of a mirror without outline have no frame in common; give "
            "outline_m in [mirror] of each"
        )
    section = measurement.model.evaluation
    align = options.align or Align(section.align)
    removal = options.remove or Removal(section.remove)
    step_mm = options.grid_step_mm if options.grid_step_mm is not None else section.grid_step_mm
    steps = [one for one in setup_steps(stated) if one.source != "fringe periods"]
    chosen = replace(options, align=align, grid_step_mm=step_mm, remove=Removal.NOTHING)
    stated_round = _measure_all(measurement.poses, chosen, steps, np.zeros(len(steps)), progress)
    one_round, joint = stated_round, _adjust(stated_round, facets, align)
    chosen = replace(chosen, grid_step_mm=stated_round.step_mm)
    for _ in range(1, _MOST_ROUNDS):
        if joint.maps.correction_rad <= _LAST_STEP_SIGMAS * joint.maps.sigma_common_rad:
            break
        usable = {name: measurement.poses[name] for name in one_round.names}
        one_round = _measure_all(usable, chosen, steps, joint.solution.common[: len(steps)], progress)
        joint = _adjust(one_round, facets, align)
    as_measured = joint.maps.maps
    with progress.stage("statistics"):
        maps = {name: remove(one, removal) for name, one in as_measured.items()}
        assembled = assemble_maps(facets, maps, align, removal)
        whole = assemble_maps(facets, as_measured, align, Removal.NOTHING)
        cantings = canting_of_facets(facets, as_measured, build_mounts(first.model.mirror)) if len(facets) > 1 else ()
        numbers = facet_numbers(assembled, whole) | joined_curl(as_measured) | canting_numbers(cantings)
    parameters = setup_parameters(stated, steps, joint.solution)
    doubts = gather_doubts(
        doubts_of_setup(parameters),
        _doubt_of_differences(joint.solution, len(one_round.names)),
        stated_round.left_out,
        one_round.left_out,
        _doubts_of_poses(one_round),
        doubt_of_canting(cantings),
    )
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    return PosesResult(
        setup=moved_setup(stated, steps, joint.solution.common[: len(steps)]),
        steps=tuple(steps),
        parameters=parameters,
        solution=joint.solution,
        poses=tuple(_rows(stated_round, one_round, joint.solution)),
        maps=maps,
        assembled=assembled,
        numbers=numbers,
        facets=numbers_of_maps(maps, as_measured, cantings),
        cantings=cantings,
        name=measurement.model.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _PoseRun:
    """One pose as it was measured.

    maps: Its maps.
    row: Where the mirror stood, and its numbers.
    follows (k, 6): How far the mirror's pose follows each common error, as `RigidTransform.moved` takes it.
    doubts: What makes it doubtful.
    """

    maps: PoseMaps
    row: PoseRow
    follows: FloatArray
    doubts: tuple[Doubt, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """All poses measured with one setup: by name; a map of each facet that all have; what was left out."""

    runs: dict[str, _PoseRun]
    templates: dict[str, SlopeMap]
    step_mm: float
    left_out: tuple[Doubt, ...]

    @property
    def names(self) -> list[str]:
        """Names of the poses that were measured."""
        return list(self.runs)


def _measure_all(
    poses: dict[str, DeflectometryMeasurement],
    options: Options,
    steps: Sequence[SetupStep],
    amounts: FloatArray,
    progress: Progress,
) -> _Round:
    """Measure the poses one after the other with the same setup; those that cannot be measured are left out."""
    runs: dict[str, _PoseRun] = {}
    templates: dict[str, SlopeMap] = {}
    left_out, names = [], set[str]()
    for number, (name, measurement) in enumerate(poses.items(), start=1):
        progress.say(f"pose {number} of {len(poses)}: {name}")

        def adjusted(setup: Setup) -> Setup:
            return moved_setup(setup, steps, amounts)

        try:
            result = measure_frames(measurement, options, progress, adjusted=adjusted)
        except EstimationError as error:
            if options.strict or len(poses) <= 2:
                raise _named(error, name) from error
            left_out.append(_left_out(name, error))
            continue
        except InputError as error:
            raise _named(error, name) from error
        maps = result.evaluation.maps
        if not templates:
            templates, names = dict(maps), set(maps)
            template = next(iter(maps.values()))
            # All poses on the grid of the first.
            options = replace(options, grid_step_mm=1e3 * round(float(template.x_m[1] - template.x_m[0]), 12))
        names &= set(maps)
        runs[name] = _PoseRun(
            PoseMaps({key: keep_map(one) for key, one in maps.items()}, amounts),
            _row(name, result),
            np.array([_follows(result, step) for step in steps]).reshape(-1, 6),
            result.doubts,
        )
    if len(runs) < 2:
        raise EstimationError(
            f"{len(runs)} of {len(poses)} poses can be measured, two are needed: "
            + "; ".join(one.text for one in left_out)
        )
    if not names:
        raise EstimationError("no facet was measured in every pose; leave out the pose that shows others")
    return _Round(
        runs, {key: one for key, one in templates.items() if key in names}, options.grid_step_mm or 0.0, tuple(left_out)
    )


def _named(error: MetrologyError, name: str) -> MetrologyError:
    """Return an error with the pose's folder in front, and its pictures."""
    named = type(error)(f"{name}: {error}")
    named.pictures = error.pictures
    return named


def _left_out(name: str, error: EstimationError) -> Doubt:
    return Doubt("pose_left_out", f"{name} was left out, the other poses go on without it: {error}")


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """What the adjustment of one round gave."""

    solution: JointSolution
    maps: JointMaps


def _adjust(one: _Round, facets: Sequence[Facet], align: Align) -> _Joint:
    poses = [pose.maps for pose in one.runs.values()]
    slopes = slopes_of_poses(poses, one.templates, facets, aligned=align is Align.NORMAL)
    solution = adjust_poses(slopes)
    return _Joint(solution, combine_maps(poses, slopes, solution, one.templates, facets))


def _row(name: str, result: Result) -> PoseRow:
    pose = result.evaluation.solution.cam_from_mirror
    located = result.evaluation.located
    turn = result.setup.cam_from_screen.inverse() @ pose
    return PoseRow(
        name=name,
        cam_from_mirror=pose,
        covariance=located.pose.covariance,
        roll_rad=float(np.arctan2(-pose.rotation[1, 0], pose.rotation[0, 0])),
        screen_distance_m=float(np.linalg.norm(turn.translation_m)),
        residual_px=None if located.evidence is None else located.evidence.residual_rms_px,
        numbers=result.numbers,
    )


def _follows(result: Result, step: SetupStep) -> FloatArray:
    """Return the step of the mirror's pose when camera and screen make one of theirs: outline and distance stay."""
    with_setup = result.evaluation.located.pose.with_setup
    if with_setup is None or not step.moves_pose:
        return np.zeros(6)
    before, after = with_setup(result.setup), with_setup(moved_setup(result.setup, (step,), np.ones(1)))
    turn = RigidTransform(after.rotation @ before.rotation.T, np.zeros(3)).rotation_vector_rad
    return np.concatenate([turn, after.translation_m - before.translation_m])


def _rows(stated: _Round, adjusted: _Round, solution: JointSolution) -> Iterator[PoseRow]:
    """Yield the poses as adjusted, with the numbers that each alone gives with the setup as stated."""
    first = solution.common.size
    for (name, one), own in zip(adjusted.runs.items(), solution.own, strict=True):
        # The errors of the mirror's own pose come first among those that a pose has for itself.
        steps = principal_steps(one.row.covariance)
        of_setup = len(one.follows)
        chosen = [*range(of_setup), *range(first, first + len(steps))]
        follows = np.concatenate([one.follows, steps])
        before = stated.runs[name]
        before_follows = np.concatenate([before.follows, principal_steps(before.row.covariance)])
        moved = np.concatenate([solution.common[:of_setup] - one.maps.measured_at, own[: len(steps)]]) @ follows
        yield replace(
            one.row,
            cam_from_mirror=one.row.cam_from_mirror.moved(moved),
            covariance=follows.T @ solution.covariance[np.ix_(chosen, chosen)] @ follows,
            outline_distance_m=before.row.distance_m,
            sigma_outline_distance_m=replace(before.row, covariance=before_follows.T @ before_follows).sigma_distance_m,
            numbers=before.row.numbers,
        )
        first += own.size


def _doubt_of_differences(solution: JointSolution, n_poses: int) -> Doubt | None:
    """Return whether the poses differ by more than noise and stated sigmas explain."""
    if solution.probability >= _LEAST_PROBABILITY or solution.noise_factor < _LEAST_FACTOR:
        return None
    return Doubt(
        "poses_differ",
        f"the slopes of the {n_poses} poses differ by {solution.noise_factor:.1f} times what noise and the stated "
        "sigmas of camera and screen explain; every sigma was enlarged by as much: state sigmas for what counts as "
        "exact ([screen] sigma_width_mm, sigma_height_mm, sigma_sag_mm, sigma_rotation_mrad, sigma_translation_mm, "
        "[camera] sigmas), and check that the mirror does not bend as it is turned and that nothing else moved",
        {"noise_factor": solution.noise_factor, "agreement_probability": solution.probability},
    )


def _doubts_of_poses(one: _Round) -> Iterator[Doubt]:
    """Yield the doubts of the single poses, each once where all of them have it."""
    codes = [{doubt.code for doubt in pose.doubts} for pose in one.runs.values()]
    in_all = set.intersection(*codes)
    listed = set[str]()
    for name, pose in one.runs.items():
        for doubt in pose.doubts:
            if doubt.code not in in_all:
                yield doubt.prefixed(name)
            elif doubt.code not in listed:
                listed.add(doubt.code)
                yield doubt.prefixed("in every pose")
