"""What can be found wrong with photos of a trough before they are evaluated."""

from dataclasses import replace

import numpy as np

from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.measurement.findings import Findings
from heliogauge.running.progress import SilentProgress
from observer.doubts.photos import refuse_impossible_cameras
from observer.doubts.stated_collector import far_targets_doubt, panels_doubts, supports_doubt
from observer.keys import ObserverMeasurement
from observer.pipeline.inputs import Inputs, build_inputs, listed_coordinates, read_tables
from observer.pipeline.reading.photos import measure_targets
from observer.pipeline.target_list import check_list, other_size_doubt
from observer.pipeline.unknown_camera import start_unknown_camera, unknown_camera_doubt
from photogrammetry.keys import CoordinateSection
from photogrammetry.pipeline import find_faults as find_faults_of_network

#: The absorber alone is measured from two photos already.
_LEAST_PHOTOS = 2
#: Photos whose targets are measured, evenly over the flight: enough to show each target from two places.
_MOST_LOOKED_AT = 12


def find_faults(measurement: ObserverMeasurement, findings: Findings) -> None:
    """Note what is wrong with collector, targets, cameras and tables.

    findings: With the images that can be read; what is found is added.
    """
    model = measurement.model
    findings.add(measurement.doubts)
    sections = [one.collector or model.collector for one in model.module] or [model.collector]
    findings.add(gather_doubts(*map(panels_doubts, sections), *map(supports_doubt, sections)))
    if measurement.photo_files:
        findings.few_photos(measurement.photo_files, _LEAST_PHOTOS, "a measurement of a trough")
    for name in [one.targets_file or model.targets_file for one in model.module] or [model.targets_file]:
        tables = findings.attempt(read_tables, measurement, name)
        if tables is None:
            continue
        coordinates: tuple[CoordinateSection, ...] | None = ()
        if name is not None and tables.targets is not None:
            coordinates = findings.attempt(listed_coordinates, tables.targets, measurement.folder / name)
        if coordinates is None:
            continue
        inputs = findings.attempt(build_inputs, measurement, tables, coordinates)
        if inputs is not None:
            findings.add(() if inputs.tilts is None else inputs.tilts.doubts)
            # A list that several modules have in common has targets beside each of them.
            if not model.module:
                findings.add(far_targets_doubt(coordinates, inputs.collector))
            survey = inputs.survey
            other = other_size_doubt(findings.sizes_px(survey.photo_files), inputs.finder)
            if other is not None:
                findings.add(other[1])
                files = tuple(file for file in survey.photo_files if file.name != other[0])
                survey = replace(survey, photo_files=files)
            find_faults_of_network(survey, findings)
            if inputs.corners is None and not findings.faults:
                _look_at_list(replace(inputs, survey=survey), findings, alone=not model.module)


def _look_at_list(inputs: Inputs, findings: Findings, *, alone: bool) -> None:
    """Note what a few photos say of the list of targets and of the camera.

    alone: Whether the flight is of one collector, whose targets each photo should show.
    """
    started = findings.attempt(start_unknown_camera, inputs, None, SilentProgress())
    if started is None:
        return
    inputs = started
    findings.add(unknown_camera_doubt(inputs))
    files = inputs.survey.photo_files
    some = files[:: -(-len(files) // _MOST_LOOKED_AT)]
    first = findings.attempt(measure_targets, some, inputs.finder, jobs=None, progress=SilentProgress())
    if first is None or not first.targets:
        return
    listed = findings.attempt(check_list, inputs.survey, inputs.finder, inputs.targets_file, first)
    if listed is not None:
        findings.add(listed.doubts)
    if first.poses:
        eyes = np.array([pose.inverse().translation_m for pose in first.poses.values()])
        findings.attempt(refuse_impossible_cameras, eyes, inputs.finder.known.points_m, inputs.collector)
    listed_names = set(inputs.finder.known.names)
    strange = [one.detections.photo for one in first.targets if not listed_names.intersection(one.detections.names)]
    if alone and 0 < len(strange) < len(some):
        named = ", ".join(strange[:5])
        text = f"{len(strange)} of {len(some)} photos that were looked at show no target of the list: {named}"
        findings.add(Doubt("photos_without_listed_targets", text, {"photos_count": len(strange)}))
