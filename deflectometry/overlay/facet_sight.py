"""Which pixels of a photo see a facet."""

import cv2
import numpy as np

from deflectometry.overlay.source_image import FacetPixels, outline_px
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray

#: Of a pixel that was rounded to whole numbers.
LEAST_NOISE_DN = 0.3
#: Pixels at the edge of a facet mix it with what is around it.
_EDGE_PX = 3
#: More pixels of one facet in one photo say nothing new of an edge.
_MOST_PIXELS = 5_000
_FEWEST_PIXELS = 200


def pixels_within(camera: Camera, pose: RigidTransform, facet: Facet) -> tuple[BoolArray, FacetPixels] | None:
    """Return the pixels (h, w) that see nothing but a facet, and those of them that are used; None where too few do.

    pose: From the heliostat to the camera.
    """
    outline = outline_px(camera, pose, facet)
    if not np.isfinite(outline).all():
        return None
    inside = np.zeros((camera.height_px, camera.width_px), np.uint8)
    cv2.fillPoly(inside, [np.rint(outline).astype(np.int32)], 1)
    eroded = cv2.erode(inside, np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8), borderValue=0) > 0
    rows, columns = np.nonzero(eroded)
    if rows.size < _FEWEST_PIXELS:
        return None
    step = max(1, round(np.sqrt(rows.size / _MOST_PIXELS)))
    chosen = (rows % step == 0) & (columns % step == 0)
    pixels = np.column_stack([columns[chosen], rows[chosen]]).astype(np.float64)
    return eroded, FacetPixels.of(camera, pose, facet, pixels)
