"""What can be found wrong with a measurement in several poses before it is evaluated."""

from deflectometry.pipeline.check import find_faults as find_faults_of_pose
from deflectometry.poses.keys import PosesMeasurement
from heliogauge.measurement.findings import Findings


def find_faults(measurement: PosesMeasurement, findings: Findings) -> None:
    """Note what is wrong with each pose.

    findings: With the images that can be read; what is found is added, the pose's folder in front.
    """
    findings.refuse_copies()
    for name, one in measurement.poses.items():
        own = Findings(photos=findings.photos)
        find_faults_of_pose(one, own)
        findings.refuse(*(f"{name}: {fault}" for fault in own.faults))
        findings.add(doubt.prefixed(name) for doubt in own.doubts)
