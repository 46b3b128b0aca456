"""Draw the pictures of the documentation from results: ``python docs/images/render.py RESULT OUT.png QUANTITY...``.

Maps of a result stand side by side. QUANTITY: a layer of its map (slope_error_x, height, ...), with ``-focus`` behind
it for the map without tilt and focus.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from heliogauge.reporting.canvas import png_of
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.view.maps import slope_map_view

#: Pages are about 1000 px wide; more than two times that is lost.
WIDTH_PX = 1500


def drawing(slope_map: SlopeMap, quantity: str) -> Figure:
    """Draw one map."""
    shown = remove(slope_map, Removal.FOCUS) if quantity.endswith("-focus") else slope_map
    return slope_map_view(shown, "").figure(quantity.removesuffix("-focus"))


def main(folder: str, out: str, *quantities: str) -> None:
    """Write maps of a folder of results as one picture."""
    slope_map = read_slope_map(Path(folder) / "slope_map.nc")
    images = [cv2.imdecode(np.frombuffer(png_of(drawing(slope_map, one)), np.uint8), 1) for one in quantities]
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
