"""Draw the picture of a calibrated heliostat: ``python docs/images/render_heliostat_report.py RESULT OUT.png``.

Residuals against time and predicted uncertainty over the sky, from the results of one heliostat.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from calibration.heliostat.report.figures_residuals import series_figures, sky_figure
from calibration.heliostat.report.results import open_heliostat
from heliogauge.reporting.canvas import png_of


def main(folder: str, out: str) -> None:
    """Write both figures side by side as one picture."""
    report = open_heliostat(folder)
    left = series_figures(report)["time"]
    parts = [
        cv2.imdecode(np.frombuffer(png_of(figure), np.uint8), cv2.IMREAD_COLOR) for figure in (left, sky_figure(report))
    ]
    height = max(len(part) for part in parts)
    parts = [np.pad(part, ((0, height - len(part)), (0, 0), (0, 0)), constant_values=255) for part in parts]
    Path(out).write_bytes(cv2.imencode(".png", np.hstack(parts), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
