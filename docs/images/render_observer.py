"""Draw the picture of a trough for the documentation: ``python docs/images/render_observer.py RESULT OUT.png``.

Slope errors of the mirror, and one photo with the outline of the absorber's reflection.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from heliogauge.reporting.canvas import png_of
from observer.report import mirror_view, open_trough, photo_view

#: Pages are about 1000 px wide.
WIDTH_PX = 1200
#: Colours of a drawing; more only make the file larger.
COLORS = 32


def main(folder: str, out: str) -> None:
    """Write both figures side by side as one picture."""
    results = open_trough(folder)
    photos = photo_view(results)
    if photos is None:
        raise SystemExit(f"{folder} holds no photo")
    left, right = (
        cv2.imdecode(np.frombuffer(png_of(figure), np.uint8), cv2.IMREAD_COLOR)
        for figure in (mirror_view(results).figure("theta_r"), photos.figure())
    )
    # The photo's noise would be most of the file.
    right = cv2.bilateralFilter(right, 7, 30, 3)
    height = left.shape[0]
    right = cv2.resize(right, (round(right.shape[1] * height / right.shape[0]), height), interpolation=cv2.INTER_AREA)
    page = np.hstack([left, right])
    page = cv2.resize(page, (WIDTH_PX, round(height * WIDTH_PX / page.shape[1])), interpolation=cv2.INTER_AREA)
    step = 256 // COLORS
    page = np.minimum(255, (page.astype(np.uint16) + step // 2) // step * step).astype(np.uint8)
    page[page > 245] = 255
    Path(out).write_bytes(cv2.imencode(".png", page, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
