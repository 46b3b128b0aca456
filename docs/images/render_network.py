"""Draw pictures of networks and cameras for the documentation: ``python docs/images/render_network.py RESULT OUT.png``.

RESULT of a photogrammetric measurement: network seen along y, and coverage of the image. RESULT of a camera
calibration: uncertainty of the lines of sight, and residuals of all photos.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from calibration.camera.files.result_folder import open_calibration
from calibration.camera.report.figures import residual_figure, sigma_figure
from heliogauge.reporting.canvas import png_of
from heliogauge.results.folder import read_summary
from photogrammetry.report.charts import residual_map
from photogrammetry.report.network import open_network
from photogrammetry.report.scene import network_figure

#: Pages are about 1000 px wide.
WIDTH_PX = 1200
#: Colours of a drawing; more only make the file larger.
COLORS = 48


def drawings(folder: Path) -> list[bytes]:
    """Return the figures of a folder of results as PNG."""
    if read_summary(folder).kind == "camera":
        return [png_of(sigma_figure(open_calibration(folder))), png_of(residual_figure(open_calibration(folder)))]
    results = open_network(folder)
    figures = (network_figure(results, 0, 2), residual_map(results).figures[0])
    return [png_of(one) for one in figures]


def main(folder: str, out: str) -> None:
    """Write the figures side by side as one picture."""
    images = [cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR) for one in drawings(Path(folder))]
    height = max(image.shape[0] for image in images)
    white = (255, 255, 255)
    padded = [
        cv2.copyMakeBorder(one, 0, height - one.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=white) for one in images
    ]
    page = np.hstack(padded)
    if page.shape[1] > WIDTH_PX:
        page = cv2.resize(page, (WIDTH_PX, round(height * WIDTH_PX / page.shape[1])), interpolation=cv2.INTER_AREA)
    step = 256 // COLORS
    page = np.minimum(255, (page.astype(np.uint16) + step // 2) // step * step).astype(np.uint8)
    page[page > 245] = 255
    Path(out).write_bytes(cv2.imencode(".png", page, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
