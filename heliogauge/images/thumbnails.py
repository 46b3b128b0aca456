"""Small pictures of photographs, so that a report shows what was measured in them."""

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.image_headers import image_header
from heliogauge.images.photos import Image

#: Longer side and size of a file: on a page of 60 photos a few hundred pixels show what was found where.
LONGER_SIDE_PX = 480
MOST_BYTES = 15_000

# Darkest and brightest pixels that are spread over all grey values, so that dark photographs show something.
_SPREAD_PERCENT = (0.5, 99.8)
_QUALITIES = (80, 65, 50, 35)
_SMALLEST_SIDE_PX = 16


def decode_thumbnail(content: bytes) -> npt.NDArray[np.uint8] | None:
    """Return the grey values of a thumbnail; None where it is damaged or larger than thumbnails are.

    Returns (height, width): Grey values [DN].
    """
    header = image_header(content)
    if header is None or max(header.width_px, header.height_px) > LONGER_SIDE_PX:
        return None
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def make_thumbnail(image_dn: Image) -> bytes:
    """Return a photograph made small, its grey values spread from black to white.

    image_dn (height, width): Grey values of any depth [DN].
    Returns: A JPEG file of at most `MOST_BYTES`.
    """
    height, width = image_dn.shape
    side = LONGER_SIDE_PX
    while side >= _SMALLEST_SIDE_PX:
        share = min(side / max(height, width), 1.0)
        size = max(round(share * width), 1), max(round(share * height), 1)
        small = cv2.resize(image_dn, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        low, high = np.percentile(small[::4, ::4], _SPREAD_PERCENT)
        grey = np.clip((small - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
        for quality in _QUALITIES:
            _, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if data.size <= MOST_BYTES:
                return data.tobytes()
        side //= 2
    raise InputError(f"photograph of {width} x {height} px: no thumbnail of {MOST_BYTES} bytes can be made")
