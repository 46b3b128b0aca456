"""Draw the pictures of the documentation from results: ``python docs/images/render.py RESULT OUT.png FIGURE FIGURE``.

Figures are those of the report; they stand side by side. FIGURE: error-x, error-y, focus-x, focus-y (slope errors
without tilt and focus), sigma-x, sigma-y, curl, height, spot, energy.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from deflectometry.report.light import spots
from heliogauge.reporting import figures
from heliogauge.reporting import page as report_page
from heliogauge.reporting.canvas import png_of
from heliogauge.slopes.removal import Removal

#: Pages are about 1000 px wide; more than two times that is lost.
WIDTH_PX = 1500


def drawing(results: report_page.Results, name: str) -> Figure:
    """Draw one figure."""
    slope_map = results.slope_map
    drawings: dict[str, Callable[[], Figure]] = {
        "error-x": lambda: figures.slope_error_map(slope_map, "x"),
        "error-y": lambda: figures.slope_error_map(slope_map, "y"),
        "focus-x": lambda: figures.slope_error_map(slope_map, "x", removed=Removal.FOCUS),
        "focus-y": lambda: figures.slope_error_map(slope_map, "y", removed=Removal.FOCUS),
        "sigma-x": lambda: figures.sigma_map(slope_map, "x"),
        "sigma-y": lambda: figures.sigma_map(slope_map, "y"),
        "curl": lambda: figures.curl_map(slope_map),
        "height": lambda: figures.height_deviation_map(slope_map),
        "spot": lambda: figures.spot_image(spots(results)["as measured"]),
        "energy": lambda: figures.encircled_energy(spots(results)),
    }
    return drawings[name]()


def main(folder: str, out: str, *names: str) -> None:
    """Write the figures of a folder of results as one picture."""
    results = report_page.open_results(folder)
    images = [cv2.imdecode(np.frombuffer(png_of(drawing(results, name)), np.uint8), cv2.IMREAD_COLOR) for name in names]
    height = max(image.shape[0] for image in images)
    padded = [
        cv2.copyMakeBorder(one, 0, height - one.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        for one in images
    ]
    page = np.hstack(padded)
    if page.shape[1] > WIDTH_PX:
        page = cv2.resize(page, (WIDTH_PX, round(height * WIDTH_PX / page.shape[1])), interpolation=cv2.INTER_AREA)
    Path(out).write_bytes(cv2.imencode(".png", page, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
