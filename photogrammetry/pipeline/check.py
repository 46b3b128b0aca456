"""What can be found wrong with photos of targets, or their image points, before the network is adjusted."""

from heliogauge.measurement.findings import Findings
from heliogauge.running.progress import SilentProgress
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.pipeline.cameras import build_cameras, refuse_camera_mismatches
from photogrammetry.pipeline.inputs import (
    build_checks,
    build_constraints,
    build_datum,
    build_knowledge,
    build_permissible_error,
    build_search,
    listed_targets,
)
from photogrammetry.pipeline.measure import Options, read_points

#: A point is in space where two photos see it.
_LEAST_PHOTOS = 2


def find_faults(measurement: PhotogrammetryMeasurement, findings: Findings) -> None:
    """Note what is wrong with cameras, targets and what is known of the object.

    findings: With the images that can be read; what is found is added.
    """
    model = measurement.model
    findings.refuse_copies()
    if measurement.photo_files:
        findings.few_photos(measurement.photo_files, _LEAST_PHOTOS, "a network")
        findings.attempt(refuse_camera_mismatches, measurement)
        sizes = findings.sizes_px(measurement.photo_files)
        if sizes:
            findings.attempt(build_cameras, measurement, list(sizes), sizes)
    else:
        measured = findings.attempt(read_points, measurement, Options(), SilentProgress())
        if measured is not None:
            findings.add(measured.doubts)
            findings.attempt(build_cameras, measurement, measured.points.photos, measured.sizes_px)
    targets = model.targets
    if targets is not None:
        findings.attempt(build_search, targets, measurement.folder)
    listed = findings.attempt(listed_targets, targets, measurement.folder)
    for build in (build_constraints, build_datum, build_checks, build_permissible_error):
        findings.attempt(build, model)
    findings.attempt(build_knowledge, measurement, None, listed)
