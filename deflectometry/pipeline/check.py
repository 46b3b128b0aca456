"""What can be found wrong with a deflectometry measurement before it is evaluated."""

from deflectometry.frames.image_file_checks import check_compression, check_size
from deflectometry.keys import BenchMeasurement, DeflectometryMeasurement
from deflectometry.pipeline.images import image_files, mend_frames, observe, observe_gray_code, read_response
from deflectometry.pipeline.inputs import (
    build_pattern,
    build_setup,
    check_missing_sigmas,
    check_screen,
    describe_mirror,
    inputs_without_sigma,
)
from deflectometry.pipeline.plausibility import refuse_impossible
from heliogauge.images.photos import read_frames
from heliogauge.measurement.findings import Findings


def find_faults(measurement: DeflectometryMeasurement, findings: Findings) -> None:
    """Note what is wrong with set-up, mirror and frames.

    findings: With the images that can be read; what is found is added.
    """
    files = image_files(measurement)
    size = findings.one_size(files)
    findings.refuse_copies()
    gray_code = measurement.model.pattern.gray_code
    pattern = None if gray_code is not None else findings.attempt(build_pattern, measurement)
    findings.attempt(read_response, measurement)
    findings.add(check_compression([file.name for file in measurement.fringe_files]))
    find_faults_of_bench(measurement, findings, size)
    if findings.faults:
        return
    frames = findings.attempt(read_frames, files)
    if frames is None:
        return
    findings.add(frames.doubts)
    if gray_code is not None:
        findings.attempt(observe_gray_code, measurement, gray_code.code, frames)
    elif pattern is not None:
        usable = findings.attempt(mend_frames, observe(measurement, pattern, frames))
        if usable is not None:
            findings.add(usable.doubts)


def find_faults_of_bench(measurement: BenchMeasurement, findings: Findings, size_px: tuple[int, int] | None) -> None:
    """Note what is wrong with camera, screen and mirror, whatever the source.

    findings: What is found is added.
    size_px: Width and height of the images; None where they differ [px].
    """
    setup = findings.attempt(build_setup, measurement)
    if setup is not None:
        unstated = inputs_without_sigma(measurement, setup)
        findings.add(check_screen(measurement, setup.screen), check_missing_sigmas(unstated))
        if size_px is not None:
            findings.attempt(check_size, size_px, setup.camera, str(measurement.folder))
        mirror = findings.attempt(describe_mirror, measurement, setup)
        if mirror is not None and mirror.known_pose is not None:
            pose = mirror.known_pose.cam_from_mirror
            findings.attempt(refuse_impossible, setup, pose)
