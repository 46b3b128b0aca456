"""Draw the picture of drawn beams for the documentation: ``python docs/images/render_heliostat.py FOLDER OUT.png``.

FOLDER is that of ``heliogauge heliostat synth FOLDER --preset images``; three beams and the empty target.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from heliogauge.images.photos import read_image

#: Morning, noon, and a day near the solstice of the first heliostat; the part of the photo with the target.
PHOTOS = ("H01_0002.png", "H01_0004.png", "H01_0012.png", "empty_00.png")
WINDOW = (slice(120, 640), slice(210, 830))
WIDTH_PX = 1200
#: Tones of a drawing; more only make the file larger.
TONES = 64


def main(folder: str, out: str) -> None:
    """Write the photos side by side, brightened so that the ambient light can be seen."""
    photos = [read_image(Path(folder) / "photos_upper" / name)[WINDOW].astype(np.float64) / 255 for name in PHOTOS]
    page = np.hstack([np.hstack([photo**0.6, np.ones((len(photo), 8))]) for photo in photos])[:, :-8]
    page = cv2.bilateralFilter(page.astype(np.float32), 5, 0.05, 2)
    page = cv2.resize(page, (WIDTH_PX, round(len(page) * WIDTH_PX / page.shape[1])), interpolation=cv2.INTER_AREA)
    page = np.rint(page * (TONES - 1)) * (255 / (TONES - 1))
    Path(out).write_bytes(cv2.imencode(".png", page.astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
