"""What can be found wrong with observations of heliostats before they are calibrated."""

from calibration.heliostat.files.result import Shared
from calibration.heliostat.files.sources import HeliostatTask
from calibration.heliostat.keys import HeliostatMeasurement
from calibration.heliostat.observations.rows import Rows, parse_rows
from calibration.heliostat.pipeline.doubts import refused_rows
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.pipeline.nominal_design import nominal_design
from calibration.heliostat.pipeline.one_heliostat import why_none
from calibration.heliostat.pipeline.reading import read_task
from heliogauge.errors import MetrologyError
from heliogauge.measurement.findings import Findings


def find_faults(measurement: HeliostatMeasurement, findings: Findings) -> None:
    """Note what is wrong with each heliostat and its observations; photos of beams are not measured.

    findings: What is found is added.
    """
    campaign = findings.attempt(Options().choose, measurement)
    if campaign is None:
        return
    findings.add(campaign.source.doubts)
    for task in campaign.source.tasks(campaign.names):
        try:
            rows = _read(task, campaign.shared, findings)
        except MetrologyError as error:
            findings.refuse(str(error) if task.name in str(error) else f"{task.name}: {error}")
        else:
            findings.add(doubt.prefixed(task.name) for doubt in refused_rows(rows))


def _read(task: HeliostatTask, shared: Shared, findings: Findings) -> Rows:
    if shared.model.images and task.header and not task.fault:
        nominal_design(task, shared.plant, shared.model.kinematics)
        return parse_rows(task.header, {int(number): text for number, text in task.records})
    seen = read_task(task, shared).seen
    if seen.observations is None:
        findings.refuse(f"{task.name}: {why_none(seen.rows)}")
    return seen.rows
