"""A photo of dots without the dots: the ground they are on."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from deflectometry.dots.found_dots import FoundDots
from heliogauge.validate import Float32Array
from photogrammetry.targets import Polarity

#: What measurement.toml calls dots of either kind.
POLARITIES = {"dark": Polarity.BLACK_ON_WHITE, "light": Polarity.WHITE_ON_BLACK}


def ground_of_dots(photo_dn: npt.NDArray[Any], dots: FoundDots, polarity: Polarity) -> Float32Array:
    """Return the photo without dots and specks: nothing as small as the distance of two dots is left.

    photo_dn (h, w): Grey values [DN].
    """
    width = int(2 * np.ceil(0.5 * dots.spacing_px) + 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    order = (cv2.MORPH_CLOSE, cv2.MORPH_OPEN)
    # Bytes take a quarter of the time of numbers.
    image = photo_dn if photo_dn.dtype == np.uint8 else photo_dn.astype(np.float32)
    for operation in order if polarity is Polarity.BLACK_ON_WHITE else order[::-1]:
        image = cv2.morphologyEx(image, operation, kernel)
    return np.asarray(image, dtype=np.float32)


def without_dots(photo_dn: npt.NDArray[Any], ground_dn: Float32Array, dots: FoundDots) -> Float32Array:
    """Return the photo with the ground in the place of each dot: what is beside dots, as the mirror's edges, stays.

    photo_dn, ground_dn (h, w): The photo, and its ground from `ground_of_dots` [DN].
    """
    near = np.zeros(photo_dn.shape, dtype=np.uint8)
    # Half the distance of two dots holds a dot with its blur.
    radius = int(np.ceil(0.5 * dots.spacing_px))
    for x, y in np.rint(dots.centers_px).astype(int).tolist():
        cv2.circle(near, (x, y), radius, 1, cv2.FILLED)
    return np.where(near > 0, ground_dn, photo_dn).astype(np.float32)
