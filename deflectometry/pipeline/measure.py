"""A measurement folder to results: read, check, evaluate, write."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from calibration.screen import ScreenResponse
from deflectometry.frames.checks import check_frames
from deflectometry.frames.image_checks import check_compression, check_noise, check_size, saturation_level
from deflectometry.fringes.phase import NoiseModel
from deflectometry.fringes.screen_map import ScreenMapLimits
from deflectometry.keys import DeflectometryMeasurement, TabulatedScreenSection
from deflectometry.pipeline.evaluate import Align, Choices, Evaluation, MirrorInput, Observation, evaluate_frames
from deflectometry.pipeline.headline import (
    Numbers,
    canting_numbers,
    facet_numbers,
    flag_words,
    geometry,
    headline_text,
    pose_numbers,
)
from deflectometry.pipeline.inputs import (
    build_facets,
    build_knowledge,
    build_pattern,
    build_pose,
    build_setup,
    read_number_columns,
)
from deflectometry.pose.mirror_pose import MirrorPose
from deflectometry.setup.bench import Setup
from deflectometry.setup.patterns import FringePattern
from deflectometry.setup.screen_table import check_beyond_table, check_screen_points
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.plausibility import implausible, refuse_impossible
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import skew
from heliogauge.images.photos import Frames, read_frames
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.models import Section
from heliogauge.results.folder import (
    PhotoPose,
    Summary,
    hash_files,
    write_cameras_json,
    write_pixels,
    write_slope_map,
    write_table_csv,
)
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True)
class Options:
    """Choices that override those of measurement.toml.

    align: Orientation that the slopes refer to; None as measurement.toml says.
    grid_step_mm: Grid step of the maps [mm]; None as measurement.toml says, else 0.4 of the spacing of the pixels.
    remove: What is taken out of the maps; None as measurement.toml says.
    jobs: Threads that decode images; None for all processors.
    """

    align: Align | None = None
    grid_step_mm: float | None = None
    remove: Removal | None = None
    jobs: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Everything a measurement gave, ready to be written.

    setup: Camera and screen as used.
    pattern: What was shown.
    evaluation: Poses, pixels and the map of each facet as measured.
    maps: The map of each measured facet, after what was to be removed.
    assembled: The map of the whole mirror, put together from these; that of the only facet where there is one.
    assembled_as_measured: The same before anything was removed.
    numbers: Headline numbers of the mirror.
    facets: Headline numbers of each facet; empty for a single one.
    """

    kind: ClassVar[str] = "deflectometry"
    setup: Setup
    pattern: FringePattern
    evaluation: Evaluation
    maps: dict[str, SlopeMap]
    assembled: SlopeMap
    assembled_as_measured: SlopeMap
    numbers: Numbers
    facets: dict[str, Numbers]

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        texts = {
            "design": self.assembled.design,
            "removed": self.assembled.removed,
            "frame": self.assembled.frame,
            "camera": f"{self.setup.camera.width_px} x {self.setup.camera.height_px} px",
            "screen": self.setup.screen.describe(),
            "pattern": _pattern_words(self.pattern),
            "pose": self.evaluation.located.source,
            "pixels": flag_words(self.evaluation),
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        return self._summary(self.numbers, texts, facets=self.facets, geometry_m=geometry(self.setup, self.evaluation))

    def write_files(self, folder: Path) -> None:
        """Write maps, pixels, cameras and outline into an existing folder."""
        evaluation = self.evaluation
        maps = dict(self.maps)
        if len(evaluation.located.facets) > 1:
            maps[ASSEMBLED] = self.assembled
        attributes = {"name": self.name, "input_sha256": self.input_sha256, "pose": evaluation.located.source}
        write_slope_map(folder / "slope_map.nc", maps, attributes)
        write_pixels(folder / "pixels.nc", _pixel_arrays(evaluation), {"name": self.name})
        write_cameras_json(folder / "cameras.json", {"camera": self.setup.camera}, _facet_poses(evaluation))
        if evaluation.located.evidence is not None:
            write_table_csv(folder / "outline.csv", _outline_columns(evaluation.located.evidence))

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def run(
    measurement: DeflectometryMeasurement, options: Options | None = None, progress: Progress | None = None
) -> Result:
    """Evaluate a measurement.

    options: Choices that override the file's.
    Returns: Maps, pixels, poses and doubts.
    InputError: Images or tables that cannot be used.
    EstimationError: Frames that contradict the pattern, no mirror, or no slopes.
    """
    options, progress = options or Options(), progress or SilentProgress()
    setup, pattern = build_setup(measurement), build_pattern(measurement)
    frames = read_frames(_image_files(measurement), jobs=options.jobs, progress=progress)
    observation = observe(measurement, pattern, frames)
    check_size(observation.frames, setup.camera, str(measurement.folder))
    with progress.stage("check frames"):
        frame_doubts = refuse_faulty_frames(observation)
    mirror = describe_mirror(measurement, setup)
    if mirror.known_pose is not None:
        refuse_impossible(setup, mirror.known_pose[0])
    evaluation = evaluate_frames(observation, setup, mirror, _choices(measurement, options), progress)
    refuse_impossible(setup, evaluation.solution.cam_from_mirror)
    as_measured = assemble_maps(evaluation, evaluation.maps, Removal.NOTHING)
    removal = evaluation.choices.removal
    maps = {name: remove(one, removal) for name, one in evaluation.maps.items()}
    assembled = as_measured if removal is Removal.NOTHING else assemble_maps(evaluation, maps, removal)
    with progress.stage("statistics"):
        numbers, facets = _numbers(evaluation, maps, (assembled, as_measured))
    doubts = gather_doubts(
        check_screen_points(setup.screen, _screen_file(measurement)),
        frames.doubts,
        check_compression([file.name for file in measurement.fringe_files]),
        frame_doubts,
        check_missing_sigmas(measurement, setup),
        evaluation.doubts,
        check_beyond_table(setup.screen, evaluation.screen_map),
        implausible(numbers, facets, evaluation),
    )
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    return Result(
        setup,
        pattern,
        evaluation,
        maps,
        assembled,
        as_measured,
        numbers,
        facets,
        name=measurement.model.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _screen_file(measurement: DeflectometryMeasurement) -> str:
    section = measurement.model.screen
    return str(measurement.path(section.file)) if isinstance(section, TabulatedScreenSection) else ""


def _image_files(measurement: DeflectometryMeasurement) -> tuple[Path, ...]:
    """Return the fringe frames, then the dark and the bright frame where there are any."""
    section = measurement.model.images
    extra = (measurement.path(text) for text in (section.dark, section.bright) if text is not None)
    return (*measurement.fringe_files, *extra)


def observe(measurement: DeflectometryMeasurement, pattern: FringePattern, frames: Frames) -> Observation:
    """Put together what the images of a measurement show.

    Returns: Frames, response, noise and limits.
    """
    section = measurement.model.images
    fringes, rest = frames.images_dn[: pattern.n_frames], frames.images_dn[pattern.n_frames :].astype(np.float32)
    lit = None
    if section.bright is not None:
        lit = rest[-1] - rest[0] if section.dark is not None else rest[-1]
    saturation = section.saturation_dn or saturation_level(fringes, frames.full_scale_dn)
    return Observation(
        frames=fringes,
        pattern=pattern,
        response=read_response(measurement),
        lit=lit,
        noise=None if section.pixel_noise_dn is None else NoiseModel(section.pixel_noise_dn),
        limits=ScreenMapLimits(saturation_dn=saturation),
    )


def read_response(measurement: DeflectometryMeasurement) -> ScreenResponse | None:
    """Read the response of camera and display, where there is one."""
    name = measurement.model.screen.response_file
    if name is None:
        return None
    camera_dn, level = read_number_columns(measurement.path(name), ("camera_dn", "display_level"))
    try:
        return ScreenResponse(camera_dn, level)
    except InputError as error:
        raise InputError(f"{measurement.path(name)}: {error}") from None


def refuse_faulty_frames(observation: Observation) -> tuple[Doubt, ...]:
    """Refuse frames that contradict the pattern; return what is doubtful about the others.

    EstimationError: At least one fault that makes the phases wrong, each with the frames and the remedy.
    """
    faults = check_frames(
        observation.frames, observation.pattern, response=observation.response,
        saturation_dn=observation.limits.saturation_dn,
    )  # fmt: skip
    errors = [fault.message for fault in faults if fault.severity == "error"]
    if errors:
        raise EstimationError("images.fringes: " + "\n  ".join(errors))
    noise = None
    if observation.noise is not None and observation.response is None:
        noise = check_noise(observation.frames, observation.pattern, observation.noise)
    return gather_doubts((fault.doubt for fault in faults), noise)


def check_missing_sigmas(measurement: DeflectometryMeasurement, setup: Setup) -> Doubt | None:
    """Return which inputs count as exact because no sigma is given; a sigma of 0.0 is a statement."""
    exact = []
    if not setup.camera.covariance.any() and not _states_sigma(measurement.model.camera):
        exact.append("the camera ([camera] sigma_focal_px ...)")
    if not setup.covariance_cam_from_screen.any() and not _states_sigma(measurement.model.screen):
        exact.append("the pose of the screen ([screen] sigma_rotation_mrad, sigma_translation_mm)")
    if not exact:
        return None
    return Doubt(
        "sigma_of_setup_missing",
        f"no sigma is given for {' nor for '.join(exact)}: counted as exact, so the common share of the "
        "uncertainty (focus, astigmatism, twist) is too small",
        {"inputs_count": len(exact)},
    )


def _states_sigma(section: Section) -> bool:
    return any(key.startswith("sigma") for key in section.model_fields_set)


def describe_mirror(measurement: DeflectometryMeasurement, setup: Setup) -> MirrorInput:
    """Put together what the file says of the mirror."""
    section = measurement.model.mirror
    pose = None if section.pose is None else build_pose(section.pose)
    return MirrorInput(
        name=measurement.model.name,
        facets=build_facets(section, measurement.model.name),
        design=build_design(section),
        known_pose=None if pose is None else (pose.cam_from_mirror, pose.covariance),
        knowledge=build_knowledge(section, setup),
    )


def _choices(measurement: DeflectometryMeasurement, options: Options) -> Choices:
    section = measurement.model.evaluation
    step_mm = options.grid_step_mm if options.grid_step_mm is not None else section.grid_step_mm
    if step_mm is not None and not step_mm > 0:
        raise InputError(f"grid step: a positive number of mm is needed, not {step_mm}")
    return Choices(
        align=options.align or Align(section.align),
        grid_step_m=0.0 if step_mm is None else step_mm * 1e-3,
        removal=options.remove or Removal(section.remove),
    )


def _facet_poses(evaluation: Evaluation) -> dict[str, PhotoPose]:
    """Return the pose of each facet; a turn of an ensemble also shifts the facets away from its origin."""
    located, cam_from_mirror = evaluation.located, evaluation.solution.cam_from_mirror
    residual = None if located.evidence is None else located.evidence.residual_rms_px
    poses = {}
    for facet in located.facets:
        carry = np.eye(6)
        carry[3:, :3] = -skew(cam_from_mirror.rotate(facet.ensemble_from_facet.translation_m))
        pose = cam_from_mirror @ facet.ensemble_from_facet
        poses[facet.name] = PhotoPose("camera", pose, carry @ located.pose.covariance @ carry.T, residual)
    return poses


def _outline_columns(evidence: MirrorPose) -> dict[str, FloatArray]:
    (x_px, y_px), (residual_x_px, residual_y_px) = evidence.points_px.T, evidence.residuals_px.T
    return {"x_px": x_px, "y_px": y_px, "residual_x_px": residual_x_px, "residual_y_px": residual_y_px}


def _numbers(
    evaluation: Evaluation, maps: dict[str, SlopeMap], assembled: tuple[SlopeMap, SlopeMap]
) -> tuple[Numbers, dict[str, Numbers]]:
    """Return the headline numbers of the mirror and of each facet."""
    numbers = facet_numbers(*assembled) | pose_numbers(evaluation.located, evaluation)
    if len(evaluation.located.facets) == 1:
        return numbers, {}
    facets = {name: canting_numbers(one) | facet_numbers(maps[name], one) for name, one in evaluation.maps.items()}
    return numbers, facets


def _pattern_words(pattern: FringePattern) -> str:
    listed = ", ".join(f"{one.axis} {one.periods:g} periods x {one.n_frames} steps" for one in pattern.sets)
    return f"{pattern.n_frames} frames: {listed}"


def _pixel_arrays(evaluation: Evaluation) -> dict[str, npt.NDArray[Any]]:
    """Put the pixels of all facets into images of the camera's size."""
    screen_map = evaluation.screen_map
    shape = screen_map.flags.shape
    arrays = {name: np.full(shape, np.nan) for name in ("x", "y", "z", "slope_x", "slope_y", "sigma_x", "sigma_y")}
    flags = screen_map.flags.copy()
    surfaces = dict(zip(evaluation.images, evaluation.solution.surfaces, strict=True))
    for name, image in evaluation.images.items():
        index = [facet.name for facet in evaluation.located.facets].index(name)
        rows = slice(image.row, image.row + image.x_m.shape[0])
        columns = slice(image.column, image.column + image.x_m.shape[1])
        own = evaluation.facet_index[rows, columns] == index
        values: dict[str, npt.NDArray[Any]] = {
            "x": image.x_m, "y": image.y_m, "z": surfaces[name].height(image.x_m, image.y_m),
            "slope_x": image.slope_x, "slope_y": image.slope_y, "sigma_x": image.sigma_x, "sigma_y": image.sigma_y,
        }  # fmt: skip
        for key, value in values.items():
            arrays[key][rows, columns][own] = value[own]
        flags[rows, columns][own] = image.flags[own]
    return {
        **arrays,
        "u": screen_map.u,
        "v": screen_map.v,
        "sigma_u": screen_map.sigma_u,
        "sigma_v": screen_map.sigma_v,
        "modulation_dn": screen_map.modulation_dn,
        "facet": (evaluation.facet_index + 1).astype(np.int16),
        "flag": flags,
    }
