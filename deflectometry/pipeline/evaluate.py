"""From frames in memory to slope maps: the stages of a measurement as functions that follow each other."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import LightResponse, NoiseModel
from deflectometry.fringes.screen_map import ScreenMap, ScreenMapLimits, measure_screen_map, modulation_image
from deflectometry.pose.given_pose import check_given_pose
from deflectometry.pose.mirror_outline import mirror_masks
from deflectometry.pose.mirror_pose import MirrorPose, locate_mirror, pose_from_points
from deflectometry.pose.pose_observations import Knowledge
from deflectometry.pose.undefined_outline import outline_from_image
from deflectometry.setup.bench import Setup
from deflectometry.setup.patterns import FringePattern
from deflectometry.shape.common_modes import PixelSamples, UncertainPose, common_modes, spread_indices, trace_samples
from deflectometry.shape.gridding import GridPlan, default_step_m, grid_slopes
from deflectometry.shape.slope_image import SlopeImage, measure_slopes
from deflectometry.shape.slopes import RoundLimits, ShapeSolution, solve_shape
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import FLAG_TEXTS, SampleFlag, count_flags
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, Quadric
from heliogauge.running.progress import Progress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Pixels that find the smooth shape of a facet, and those that carry the common modes: with 2000 and 400 the
#: coefficients of degree 4 and 3 are known 30 times better than a single pixel.
SHAPE_PIXELS = 2000
MODE_PIXELS = 400
#: Pixels that decide the tilt at last: it is the mean of a rough surface, 2000 pixels of 0.5 mrad leave 0.011 mrad.
ALIGN_PIXELS = 16000
#: A facet with fewer usable pixels than this determines no shape of degree 4.
FEWEST_PIXELS = 60


class Align(StrEnum):
    """To which orientation the slopes refer."""

    NORMAL = "normal"
    OUTLINE = "outline"


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """The images of one measurement.

    frames (n, h, w): Fringe frames in the order of the pattern [DN].
    pattern: What was shown.
    response: Makes readings linear in the display's level.
    lit (h, w): Bright minus dark frame: shows the mirror against its surroundings [DN].
    noise: Noise of a reading; estimated without it.
    limits: Error probabilities and saturation.
    """

    frames: npt.NDArray[Any]
    pattern: FringePattern
    response: LightResponse | None = None
    lit: Float32Array | None = None
    noise: NoiseModel | None = None
    limits: ScreenMapLimits = field(default_factory=ScreenMapLimits)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorInput:
    """What is known of the mirror before it is measured.

    facets: Facets with outline and design; empty where the outline is not known.
    design: Design of a mirror without outline, in the frame whose origin is the middle of what is seen.
    known_pose: cam_from_mirror and its covariance, where it was measured otherwise.
    knowledge: Distances, known points and roll that help to find the pose.
    """

    name: str
    facets: tuple[Facet, ...]
    design: Quadric
    known_pose: tuple[RigidTransform, FloatArray] | None
    knowledge: Knowledge


@dataclass(frozen=True, slots=True, eq=False)
class Choices:
    """How the slopes are to be reported.

    align: Orientation the slopes refer to.
    grid_step_m: Grid step of the maps; 0 takes 0.4 of the spacing of the pixels [m].
    removal: What is taken out of the maps.
    """

    align: Align = Align.NORMAL
    grid_step_m: float = 0.0
    removal: Removal = Removal.NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class LocatedMirror:
    """Where the mirror is.

    facets: Facets; of a mirror without outline the one made from its image.
    pose: Pose before alignment.
    margin_px: Distance to the outline below which pixels mix the mirror with its surroundings [px].
    source: Where the pose comes from, in words with numbers.
    outline_pose: Pose whose outline lies on the edges in the image: says which pixels see the mirror. Differs from
        `pose` only where that was given.
    evidence: The adjustment, where the outline gave the pose.
    doubts: What makes the pose doubtful.
    """

    facets: tuple[Facet, ...]
    pose: UncertainPose
    margin_px: float
    source: str
    outline_pose: RigidTransform
    evidence: MirrorPose | None = None
    doubts: tuple[Doubt, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _UsableFacets:
    """Facets that show fringes: their numbers, some of their pixels, and why others were left out."""

    numbers: list[int]
    samples: list[PixelSamples]
    doubts: list[Doubt]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Everything a measurement gave.

    located: Pose before alignment and its evidence.
    screen_map: Display point of each pixel.
    facet_index (h, w): Facet of each pixel, -1 elsewhere.
    solution: Aligned pose and smooth shapes of the facets that were measured.
    images: Pixels of each measured facet.
    maps: Slope map of each measured facet, with nothing taken out but by the alignment.
    choices: How the slopes are reported.
    doubts: What makes pose, facets or maps doubtful.
    """

    located: LocatedMirror
    screen_map: ScreenMap
    facet_index: npt.NDArray[np.int16]
    solution: ShapeSolution
    images: dict[str, SlopeImage]
    maps: dict[str, SlopeMap]
    choices: Choices
    doubts: tuple[Doubt, ...] = ()


def evaluate_frames(
    observation: Observation, setup: Setup, mirror: MirrorInput, choices: Choices, progress: Progress
) -> Evaluation:
    """Evaluate the frames of one measurement.

    setup: Camera and screen.
    Returns: Slopes of pixels and maps.
    InputError: Frames that do not fit camera or pattern.
    EstimationError: No mirror found, or none of its facets shows fringes.
    """
    height, width = observation.frames.shape[1:]
    if (width, height) != (setup.camera.width_px, setup.camera.height_px):
        raise InputError(
            f"frames: {width} x {height} px, but the camera is for {setup.camera.width_px} x "
            f"{setup.camera.height_px} px; give the camera of these images, or images that were not cut or scaled"
        )
    with progress.stage("find mirror"):
        located = locate(observation, setup, mirror)
        masks = mirror_masks(setup.camera, located.outline_pose, located.facets, margin_px=located.margin_px)
    with progress.stage("phase"):
        screen_map = measure_screen_map(
            observation.frames, observation.pattern, response=observation.response, region=masks.facet_index >= 0,
            noise=observation.noise, limits=observation.limits,
        )  # fmt: skip
        flags = np.where(masks.flags != 0, masks.flags, screen_map.flags)
        screen_map = replace(screen_map, flags=flags)
    with progress.stage("slopes"):
        usable = _usable_facets(located, screen_map, masks.facet_index)
        samples = usable.samples
        align = choices.align is Align.NORMAL
        solution = _solve(setup, samples, located.pose.cam_from_mirror, align=align)
        images = {}
        for index, sample, surface in zip(usable.numbers, samples, solution.surfaces, strict=True):
            pose = solution.cam_from_mirror @ sample.facet.ensemble_from_facet
            images[sample.facet.name] = measure_slopes(setup, screen_map, masks.facet_index == index, pose, surface)
    with progress.stage("uncertainty"):
        thinned = [_thin(sample, max(MODE_PIXELS // len(samples), 60)) for sample in samples]
        modes = common_modes(setup, thinned, solution, located.pose, align=align)
    with progress.stage("maps", steps=len(images)) as stage:
        plan = _plan_grid(images, [sample.facet for sample in samples], choices, len(located.facets))
        gridded = {}
        for sample, surface, common in zip(samples, solution.surfaces, modes, strict=True):
            facet = sample.facet
            view = (setup.camera, solution.cam_from_mirror @ facet.ensemble_from_facet)
            gridded[facet.name] = grid_slopes(images[facet.name], surface, view, facet, plan=plan, common=common)
            stage.advance()
    doubts = gather_doubts(located.doubts, usable.doubts, *(one.doubts for one in gridded.values()))
    maps = {name: one.slope_map for name, one in gridded.items()}
    return Evaluation(located, screen_map, masks.facet_index, solution, images, maps, choices, doubts)


def locate(observation: Observation, setup: Setup, mirror: MirrorInput) -> LocatedMirror:
    """Find where the mirror is: from the pose as given, from its outline, or from its reflection alone.

    observation: Frames and pattern.
    setup: Camera and screen.
    EstimationError: No mirror in view, or an outline that does not fit.
    """
    image = observation.lit
    if image is None:
        image = modulation_image(observation.frames, observation.pattern, response=observation.response)
    if mirror.facets and mirror.known_pose is not None:
        checked = check_given_pose(image, setup.camera, mirror.facets, *mirror.known_pose)
        source = f"given in measurement.toml; its outline lies {checked.residual_rms_px:.3f} px RMS off the edges"
        pose = UncertainPose(*mirror.known_pose)
        doubts = gather_doubts(checked.doubt)
        return LocatedMirror(mirror.facets, pose, checked.margin_px, source, checked.outline_pose, doubts=doubts)
    if not mirror.facets:
        return _locate_without_outline(observation, image, setup, mirror)
    evidence = locate_mirror(image, setup.camera, mirror.facets, mirror.knowledge)
    source = (
        f"outline in the image: {evidence.n_points} edge points, residual {evidence.residual_rms_px:.3f} px RMS, "
        f"{evidence.n_rejected} rejected"
    )
    return LocatedMirror(
        mirror.facets,
        _uncertain(evidence),
        evidence.mask_margin_px,
        source,
        evidence.cam_from_mirror,
        evidence,
        evidence.doubts,
    )


def _uncertain(evidence: MirrorPose) -> UncertainPose:
    return UncertainPose(evidence.cam_from_mirror, evidence.covariance, evidence.with_setup)


def _locate_without_outline(
    observation: Observation, image: Float32Array, setup: Setup, mirror: MirrorInput
) -> LocatedMirror:
    """Make a facet from what is seen: the outline from the image, the pose from the reflection and the distance."""
    rough = outline_from_image(image)
    screen_map = measure_screen_map(
        observation.frames, observation.pattern, response=observation.response, region=rough.region,
        noise=observation.noise, limits=observation.limits,
    )  # fmt: skip
    evidence = None
    if mirror.known_pose is not None:
        pose, source = UncertainPose(*mirror.known_pose), "given in measurement.toml (no outline given)"
    elif len(mirror.knowledge.points.points_m):
        evidence = pose_from_points(setup.camera, mirror.knowledge)
        pose = _uncertain(evidence)
        source = f"{evidence.n_points} known points, residual {evidence.residual_rms_px:.3f} px RMS (no outline given)"
    else:
        reflect = partial(rough.pose, screen_map, mirror.knowledge, mirror.design)
        pose = UncertainPose(*reflect(setup), lambda other: reflect(other)[0])
        source = "reflection at the middle of the mirror and the measured distance (no outline given)"
    facet = rough.facet(mirror.name, mirror.design, setup.camera, pose.cam_from_mirror)
    doubts = () if evidence is None else evidence.doubts
    return LocatedMirror((facet,), pose, rough.margin_px, source, pose.cam_from_mirror, evidence, doubts)


def _usable_facets(located: LocatedMirror, screen_map: ScreenMap, facet_index: npt.NDArray[np.int16]) -> _UsableFacets:
    """Pick the facets that show fringes, with some of their pixels."""
    found = _UsableFacets([], [], [])
    for index, facet in enumerate(located.facets):
        region = facet_index == index
        usable = np.flatnonzero(region & (screen_map.flags == 0))
        if usable.size < FEWEST_PIXELS:
            numbers = {"usable_pixels_count": usable.size, "pixels_count": int(np.count_nonzero(region))}
            found.doubts.append(Doubt("facet_not_measured", _why_not(facet, region, screen_map), numbers))
            continue
        most = max(ALIGN_PIXELS // len(located.facets), SHAPE_PIXELS)
        chosen = usable[spread_indices(usable.size, most)]
        row, column = np.divmod(chosen, facet_index.shape[1])
        pixels = np.stack([column, row], axis=-1).astype(np.float64)
        found.numbers.append(index)
        found.samples.append(PixelSamples(facet, pixels, screen_map.u.flat[chosen], screen_map.v.flat[chosen]))
    if not found.samples:
        raise EstimationError(_why_not(located.facets[0], facet_index == 0, screen_map))
    return found


def _solve(setup: Setup, samples: Sequence[PixelSamples], start: RigidTransform, *, align: bool) -> ShapeSolution:
    """Find shape and tilt with a part of the pixels, then with all that were picked."""
    part = trace_samples(setup, [_thin(sample, SHAPE_PIXELS) for sample in samples])
    solution = solve_shape(part, start, align=align)
    # Two rounds from there: what the further pixels change is small, and its square is nothing.
    rest = RoundLimits(outer=2, must_settle=False)
    return solve_shape(
        trace_samples(setup, samples), solution.cam_from_mirror, align=align, start=solution, rounds=rest
    )


def _why_not(facet: Facet, region: BoolArray, screen_map: ScreenMap) -> str:
    total = int(np.count_nonzero(region))
    if total == 0:
        return f"facet {facet.name} fills no pixel of the image; check the mirror's pose"
    counts = count_flags(screen_map.flags, region)
    reasons = ", ".join(f"{FLAG_TEXTS[flag]} ({count} px)" for flag, count in counts.items())
    remedy = "check screen, exposure and pattern"
    if SampleFlag.OFF_SCREEN in counts:
        remedy = "show the pattern over a larger screen or move the mirror"
    elif counts and max(counts, key=lambda flag: counts[flag]) is SampleFlag.FRINGE_ORDER_UNCERTAIN:
        remedy = "add fringes of fewer periods: one set below 1, each next at most about six times finer"
    return f"facet {facet.name} was not measured: of its {total} px {reasons or 'none is flagged'}; {remedy}"


def _thin(sample: PixelSamples, most: int) -> PixelSamples:
    chosen = spread_indices(len(sample.pixels_px), most)
    return replace(sample, pixels_px=sample.pixels_px[chosen], u=sample.u[chosen], v=sample.v[chosen])


def _plan_grid(images: dict[str, SlopeImage], facets: Sequence[Facet], choices: Choices, n_facets: int) -> GridPlan:
    """Choose one grid step for all facets, and the words of their maps; n_facets counts those not measured too."""
    step_m = choices.grid_step_m
    if step_m == 0.0:
        finest = min(image.footprint_m for image in images.values())
        step_m = default_step_m(finest, sum(facet.area_m2 for facet in facets))
    return GridPlan(step_m, frame=_frame_words(n_facets), removed=alignment_words(choices.align, n_facets))


def _frame_words(n_facets: int) -> str:
    own = "facet frame: x across, y up, seen from the front, z out of the mirror [m]"
    return own if n_facets == 1 else f"{own}; one frame for each facet, placed by the ensemble's definition"


def alignment_words(align: Align, n_facets: int) -> str:
    """Say what the alignment took out of the slopes of a mirror of so many facets."""
    if align is Align.OUTLINE:
        return "nothing; the orientation is that of the pose"
    if n_facets == 1:
        return "mean tilt, by turning the mirror's frame until the best-fit surface has the design's normal"
    return "mean tilt of the ensemble, by turning its frame; the canting of single facets is kept"
