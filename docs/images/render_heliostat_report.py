"""Draw the picture of a calibrated heliostat: ``python docs/images/render_heliostat_report.py RESULT OUT.svg``.

Residuals against time and predicted uncertainty over the sky, from the results of one heliostat.
"""

import sys
from pathlib import Path

from calibration.heliostat.report.charts import series_views
from calibration.heliostat.report.figures_residuals import sky_sheet
from calibration.heliostat.report.results import open_heliostat
from heliogauge.view.stills import Sheet


def main(folder: str, out: str) -> None:
    """Write both side by side as one picture."""
    report = open_heliostat(folder)
    left, right = series_views(report)["time"].sheet(), sky_sheet(report)
    size = left.width + right.width, max(left.height, right.height)
    page = Sheet(*size, left.box, left.x_limits, left.y_limits)
    page.inset(left, 0.0, 0.0)
    page.inset(right, left.width, 0.0)
    Path(out).write_text(page.svg(), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
