"""What can be found wrong with a photo of dots before it is evaluated."""

import numpy as np

from deflectometry.dots.found_dots import find_dots
from deflectometry.dots.ground import POLARITIES
from deflectometry.dots.keys import DotsMeasurement
from deflectometry.frames.image_file_checks import check_compression
from deflectometry.pipeline.check import find_faults_of_bench
from heliogauge.images.photos import read_frames
from heliogauge.measurement.findings import Findings


def find_faults(measurement: DotsMeasurement, findings: Findings) -> None:
    """Note what is wrong with set-up, mirror and photo.

    findings: With the images that can be read; what is found is added.
    """
    file = measurement.path(measurement.model.photo)
    findings.add(check_compression([file.name]))
    find_faults_of_bench(measurement, findings, findings.one_size((file,)))
    if findings.faults:
        return
    frames = findings.attempt(read_frames, (file,))
    if frames is not None:
        findings.add(frames.doubts)
        photo = np.asarray(frames.images_dn[0])
        everywhere = np.ones(photo.shape, dtype=np.bool_)
        findings.attempt(find_dots, photo, everywhere, POLARITIES[measurement.model.pattern.dots])
