"""What can be found wrong with photos of a calibration board before the camera is calibrated."""

from calibration.camera.keys import CameraCalibrationMeasurement
from calibration.camera.pipeline.inputs import described_board, known_codes
from calibration.camera.pipeline.photos import left_out_doubts
from heliogauge.measurement.findings import Findings

#: Three views of a plane determine a camera with a free principal point (Zhang 2000, section 3.1).
_LEAST_PHOTOS = 3


def find_faults(measurement: CameraCalibrationMeasurement, findings: Findings) -> None:
    """Note what is wrong with the board and the photos as files.

    findings: With the images that can be read; what is found is added.
    """
    findings.few_photos(measurement.photo_files, _LEAST_PHOTOS, "a calibration")
    findings.one_size(measurement.photo_files)
    findings.add(left_out_doubts(f"{copy.name} is a copy of {one.name}" for copy, one in findings.copies.items()))
    findings.attempt(described_board, measurement)
    findings.attempt(known_codes, measurement)
