"""Camera raw files, decoded by LibRaw: values that grow in proportion to the light, on the raster of the sensor."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.files.image_headers import ImageHeader

#: Endings of the files. OpenCV takes some of these for TIFF and returns the preview they carry.
CAMERA_RAW = frozenset({".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw"})


def is_camera_raw(path: Path) -> bool:
    """Return whether a file is one of a camera's raw values, by its ending."""
    return path.suffix.lower() in CAMERA_RAW


def raw_header(path: Path, content: bytes) -> ImageHeader:
    """Return what a camera raw file says of its raster; nothing is decoded.

    InputError: No camera raw file, or the library that reads them is not installed.
    """
    with _opened(path, content) as raw:
        # LibRaw keeps four colours of each pixel: two greens.
        return ImageHeader("camera raw", int(raw.sizes.width), int(raw.sizes.height), 4, 2)


def decode_raw(path: Path, content: bytes) -> npt.NDArray[np.uint16]:
    """Return the colours of a camera raw file, shape (height, width, 3) in OpenCV's order, full scale 65535 [DN].

    Black is taken off and the sensor's white is full scale; between them values are in proportion to the light. Colours
    are the sensor's own, without white balance; where a pixel lacks one it is the mean of its neighbours', which is
    linear in the light too. The picture is not turned.

    InputError: No camera raw file, a damaged one, or the library that reads them is not installed.
    """
    library = of_extra("rawpy")
    with _opened(path, content) as raw:
        try:
            colours = raw.postprocess(
                demosaic_algorithm=library.DemosaicAlgorithm.LINEAR,
                output_color=library.ColorSpace.raw,
                use_camera_wb=False,
                user_wb=[1.0, 1.0, 1.0, 1.0],
                gamma=(1, 1),
                no_auto_bright=True,
                # Else a frame's own brightest value becomes its full scale, and two frames cannot be compared.
                adjust_maximum_thr=0.0,
                output_bps=16,
                user_flip=0,
            )
        except library.LibRawError as error:
            raise InputError(f"{path}: the camera raw file is damaged ({_words(error)}); copy it again") from None
    return np.ascontiguousarray(colours[..., ::-1])


def _opened(path: Path, content: bytes) -> Any:
    library = of_extra("rawpy")
    try:
        return library.imread(BytesIO(content))
    except library.LibRawError as error:
        raise InputError(
            f"{path}: no camera raw file that can be read ({_words(error)}); copy it again, or convert it to 16-bit "
            "TIFF, linear"
        ) from None


def _words(error: Exception) -> str:
    text = error.args[0] if error.args else ""
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)
