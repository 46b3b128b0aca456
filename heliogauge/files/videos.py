"""Videos: containers that hold their frames themselves."""

import os
from pathlib import Path
from typing import Any

import cv2

from heliogauge.errors import InputError
from heliogauge.files.regular import open_regular

#: Largest frame that is read; 8K video has 33 million pixels.
MOST_FRAME_PIXELS = 134_000_000

_BOXES = frozenset({b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip", b"pnot"})
_NEEDED = "an undamaged MP4, MOV, AVI, MKV or MPEG file is needed, or photos"
_MATROSKA, _MPEG, _TRANSPORT_BYTES = b"\x1a\x45\xdf\xa3", (b"\0\0\1\xba", b"\0\0\1\xb3"), 188
#: Packets of a transport stream that are looked at: a text has a G at the start of two by chance, not of five.
_PACKETS = 5


def open_video(path: Path) -> Any:
    """Open a video for decoding.

    Returns: OpenCV's capture; it ignores the container's note that the picture was turned.
    InputError: No regular file, no container that holds frames itself, or frames that are too large.
    """
    with open_regular(path, "a video") as file:
        size = os.fstat(file.fileno()).st_size
        beginning = file.read((_PACKETS - 1) * _TRANSPORT_BYTES + 1)
    if not _is_container(beginning):
        # The decoder also takes lists of other files and addresses, and follows them.
        raise InputError(f"{path}: cannot be opened as a video ({size} bytes); {_NEEDED}")
    try:
        # By an absolute name: the decoder reads names such as concat:a.mp4 as addresses.
        capture = cv2.VideoCapture(os.path.abspath(path), cv2.CAP_FFMPEG)
    except cv2.error as error:
        raise InputError(f"{path}: cannot be opened as a video ({error.err})") from None
    if not capture.isOpened():
        raise InputError(f"{path}: cannot be opened as a video ({size} bytes); {_NEEDED}")
    width, height = (int(capture.get(one)) for one in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if not 0 < width * height <= MOST_FRAME_PIXELS:
        capture.release()
        raise InputError(
            f"{path}: frames of {width} x {height} px; at most {MOST_FRAME_PIXELS / 1e6:.0f} million pixels are read"
        )
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture


def _is_container(content: bytes) -> bool:
    """Return whether a file begins as those do that hold frames themselves."""
    is_avi = content.startswith(b"RIFF") and content[8:12] == b"AVI "
    is_stream = content[::_TRANSPORT_BYTES] == _PACKETS * b"G"
    return is_avi or is_stream or content[4:8] in _BOXES or content.startswith((_MATROSKA, *_MPEG))
