"""What can be found wrong with photos of a trough before they are evaluated."""

from dataclasses import replace

from heliogauge.doubts import gather_doubts
from heliogauge.measurement.findings import Findings
from observer.doubts.stated_collector import far_targets_doubt, panels_doubts, supports_doubt
from observer.keys import ObserverMeasurement
from observer.pipeline.inputs import build_inputs, listed_coordinates, read_tables
from observer.pipeline.target_list import other_size_doubt
from photogrammetry.keys import CoordinateSection
from photogrammetry.pipeline import find_faults as find_faults_of_network

#: The absorber alone is measured from two photos already.
_LEAST_PHOTOS = 2


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
