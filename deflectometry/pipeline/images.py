"""From the images of a measurement to what is evaluated; frames that contradict the pattern are mended or refused."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.screen import ScreenResponse
from deflectometry.frames.image_file_checks import check_noise, saturation_level
from deflectometry.frames.repair import repair_frames
from deflectometry.frames.sequence_checks import shorten_faults
from deflectometry.fringes.gray_code import GrayCodeObservation
from deflectometry.fringes.known_point import KnownDisplayPoint
from deflectometry.fringes.observation import Observation
from deflectometry.fringes.screen_map import ScreenMapLimits
from deflectometry.keys import DeflectometryMeasurement
from deflectometry.setup.patterns import FringePattern, GrayCode
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, FailurePicture, InputError
from heliogauge.images.photos import Frames
from heliogauge.results.tables import read_number_columns
from heliogauge.validate import Float32Array, FloatArray


def image_files(measurement: DeflectometryMeasurement) -> tuple[Path, ...]:
    """Return the fringe frames, then the dark and the bright frame where there are any."""
    section = measurement.model.images
    extra = (measurement.path(text) for text in (section.dark, section.bright) if text is not None)
    return (*measurement.fringe_files, *extra)


def observe(measurement: DeflectometryMeasurement, pattern: FringePattern, frames: Frames) -> Observation:
    """Put together what the images of a measurement show.

    Returns: Frames, response, noise and limits.
    InputError: The dark frame is the brighter one.
    """
    section = measurement.model.images
    fringes, lit = frames.images_dn[: pattern.n_frames], _lit(measurement, frames)
    saturation = section.saturation_dn or saturation_level(fringes, frames.full_scale_dn)
    return Observation(
        frames=fringes,
        pattern=pattern,
        response=read_response(measurement),
        lit=lit,
        noise=None if section.pixel_noise_dn is None else NoiseModel(section.pixel_noise_dn),
        limits=ScreenMapLimits(saturation_dn=saturation),
        known_point=read_known_point(measurement),
    )


def observe_gray_code(measurement: DeflectometryMeasurement, code: GrayCode, frames: Frames) -> GrayCodeObservation:
    """Put together what the images of a Gray code show.

    InputError: The dark frame is the brighter one.
    """
    noise_dn = measurement.model.images.pixel_noise_dn
    return GrayCodeObservation(
        frames.images_dn[: code.n_frames],
        code,
        lit=_lit(measurement, frames),
        noise=None if noise_dn is None else NoiseModel(noise_dn),
    )


def _lit(measurement: DeflectometryMeasurement, frames: Frames) -> Float32Array | None:
    """Return the bright minus the dark frame, where there are some; they follow those of the pattern."""
    section = measurement.model.images
    if section.bright is None:
        return None
    rest = frames.images_dn[measurement.model.pattern.n_frames :].astype(np.float32)
    if section.dark is None:
        return np.asarray(rest[-1])
    lit = np.asarray(rest[-1] - rest[0])
    if lit.sum() < 0:
        raise InputError(
            f"images.dark ({section.dark}) is brighter than images.bright ({section.bright}): exchange the two; "
            "the bright one shows the display white"
        )
    return lit


def read_known_point(measurement: DeflectometryMeasurement) -> KnownDisplayPoint | None:
    """Read from where fringe orders are counted, where that is stated."""
    section = measurement.model.pattern.known_point
    if section is None:
        return None
    return KnownDisplayPoint(
        np.asarray(section.image_px), np.asarray(section.display), np.full(2, section.sigma_display)
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


@dataclass(frozen=True, slots=True, eq=False)
class UsableFrames:
    """What the frames of a measurement can be used for.

    observation: Frames and pattern as they are evaluated; the very ones given where nothing had to be mended.
    doubts: What was mended, and what is doubtful.
    sigma_periods (2,): Relative standard deviations of the scale of u and of v where periods were estimated.
    """

    observation: Observation
    doubts: tuple[Doubt, ...]
    sigma_periods: FloatArray


def mend_frames(observation: Observation, *, strict: bool = False) -> UsableFrames:
    """Use faulty frames as far as they go; refuse what cannot be mended.

    strict: Refuse whatever had to be mended.
    EstimationError: At least one fault that makes the phases wrong, each with the frames and the remedy.
    """
    repaired = repair_frames(
        observation.frames,
        observation.pattern,
        response=observation.response,
        saturation_dn=observation.limits.saturation_dn,
    )
    refused = repaired.found if strict else repaired.errors
    messages = [fault.message for fault in shorten_faults(list(refused))]
    if strict and not messages:
        messages = [doubt.text for doubt in repaired.repairs]
    if messages:
        raise EstimationError("images.fringes: " + "\n  ".join(messages))
    noise = None
    if observation.noise is not None and observation.response is None:
        noise = check_noise(observation.frames, observation.pattern, observation.noise)
    doubts = gather_doubts(repaired.repairs, (fault.doubt for fault in repaired.faults), noise)
    used = replace(observation, frames=repaired.frames, pattern=repaired.pattern)
    return UsableFrames(used, doubts, repaired.sigma_periods)


def pictures_of_frames(observation: Observation | GrayCodeObservation) -> Iterator[FailurePicture]:
    """Yield what shows why a measurement failed: contrast of the fringes, light on the mirror, frames."""
    frames = observation.frames
    # Without the response: frames that contradict the pattern may have no modulation in its unit.
    spread = frames.max(axis=0).astype(np.float32) - frames.min(axis=0)
    largest = float(spread.max())
    note = f"brightest minus darkest frame, up to {largest:.0f} DN; the mirror must stand out bright, with a sharp edge"
    yield FailurePicture("contrast of the fringes", spread, note)
    if observation.lit is not None:
        yield FailurePicture("bright minus dark frame", observation.lit, "the mirror must stand out bright")
    for number in dict.fromkeys((0, len(frames) // 2, len(frames) - 1)):
        yield FailurePicture(
            f"frame {number + 1} of {len(frames)}", frames[number], "fringes must be seen in the mirror"
        )
