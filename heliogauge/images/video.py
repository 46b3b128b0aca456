"""Read single frames of a video as photographs: the only place that decodes video files.

A frame is named by a path that no file has: ``pass.mp4#00012`` is the thirteenth frame that can be decoded of
``pass.mp4``. `heliogauge.images.photos.read_image` takes such a path like that of a photograph. Frames are counted by
decoding, not by the container's index and times: those are wrong where a recorder dropped frames, and a decoder that
is sent to a time stops at a neighbour.
"""

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.files.regular import open_regular
from heliogauge.images.video_names import FRAME

#: Largest frame that is read; 8K video has 33 million pixels.
MOST_FRAME_PIXELS = 134_000_000

_BOXES = frozenset({b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip", b"pnot"})
_NEEDED = "an undamaged MP4, MOV, AVI, MKV or MPEG file is needed, or photos"
_MATROSKA, _MPEG, _TRANSPORT_BYTES = b"\x1a\x45\xdf\xa3", (b"\0\0\1\xba", b"\0\0\1\xb3"), 188
#: Each thread reads on from where it was; it comes to its frames in ascending order.
_OWN = threading.local()


@dataclass(frozen=True, slots=True, eq=False)
class VideoFrames:
    """The frames of a video.

    files: Path of each frame, to be read with `heliogauge.images.photos.read_image`.
    doubts: What is wrong with the video and was got round.
    """

    files: tuple[Path, ...]
    doubts: tuple[Doubt, ...]


@dataclass(slots=True, eq=False)
class _Reader:
    """An open video and its latest frame."""

    video: Path
    capture: Any
    following: int = 0
    latest: npt.NDArray[np.uint8] | None = None


def list_frames(video: Path, *, every_nth: int = 1) -> VideoFrames:
    """Decode a whole video once and name its frames.

    every_nth: Take only every nth frame, the first one included.
    Returns: Its frames; exact copies of the frame taken before are left out, because they measure nothing new.
    """
    capture = _open(video)
    files, copies, number = [], 0, 0
    before: npt.NDArray[Any] | None = None
    while capture.grab():
        if number % every_nth == 0:
            got, frame = capture.retrieve()
            if not got:
                break
            if before is not None and np.array_equal(frame, before):
                copies += 1
            else:
                files.append(video.with_name(f"{video.name}#{number:05d}"))
            before = frame
        number += 1
    if not files:
        raise InputError(f"{video}: no frame can be decoded; is it a whole video? Otherwise give photos")
    doubts = []
    stated = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    if number < stated:
        text = (
            f"{video.name}: {number} of the {stated} frames that it claims to have could be decoded; the rest of the "
            "file is missing or damaged: was it copied completely?"
        )
        doubts.append(Doubt("video_is_incomplete", text, {"frames_count": number, "stated_frames_count": stated}))
    if copies:
        text = f"{video.name}: {copies} frames are exact copies of the ones before and were left out"
        doubts.append(Doubt("video_frames_repeat", text, {"frames_count": copies}, Severity.NOTE))
    return VideoFrames(tuple(files), tuple(doubts))


def frames_per_second(video: Path) -> float | None:
    """Return how many frames of a video follow in a second, as its container says; None where it does not.

    InputError: It cannot be opened.
    """
    rate = float(_open(video).get(cv2.CAP_PROP_FPS))
    return rate if np.isfinite(rate) and rate > 0 else None


def read_frame(path: Path) -> npt.NDArray[np.uint8]:
    """Decode one frame.

    Returns (height, width, 3): Blue, green, red [DN], in the raster of the sensor: the container's note that the
        picture was turned is ignored.
    """
    found = FRAME.fullmatch(path.name)
    if found is None:
        raise InputError(f"{path}: a frame is named like pass.mp4#00012")
    video, number = path.with_name(found["video"]), int(found["number"])
    reader: _Reader | None = getattr(_OWN, "reader", None)
    if reader is None or reader.video != video or number < reader.following - 1:
        reader = _OWN.reader = _Reader(video, _open(video))
    while reader.following < number and reader.capture.grab():
        reader.following += 1
    if reader.following == number:
        got, frame = reader.capture.read()
        reader.latest = np.asarray(frame, dtype=np.uint8) if got else None
        reader.following += 1
    if reader.following != number + 1 or reader.latest is None:
        _OWN.reader = None
        raise InputError(f"{video}: frame {number} cannot be decoded; has the file changed?")
    return reader.latest


def _is_container(content: bytes) -> bool:
    """Return whether a file begins as those do that hold frames themselves."""
    is_avi = content.startswith(b"RIFF") and content[8:12] == b"AVI "
    is_stream = content[:1] == b"G" and content[_TRANSPORT_BYTES:] == b"G"
    return is_avi or is_stream or content[4:8] in _BOXES or content.startswith((_MATROSKA, *_MPEG))


def _open(video: Path) -> Any:
    with open_regular(video, "a video") as file:
        beginning = file.read(_TRANSPORT_BYTES + 1)
    if not _is_container(beginning):
        # The decoder also takes lists of other files and addresses, and follows them.
        raise InputError(f"{video}: cannot be opened as a video ({video.stat().st_size} bytes); {_NEEDED}")
    try:
        capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    except cv2.error as error:
        raise InputError(f"{video}: cannot be opened as a video ({error.err})") from None
    if not capture.isOpened():
        raise InputError(f"{video}: cannot be opened as a video ({video.stat().st_size} bytes); {_NEEDED}")
    width, height = (int(capture.get(one)) for one in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if not 0 < width * height <= MOST_FRAME_PIXELS:
        capture.release()
        raise InputError(
            f"{video}: frames of {width} x {height} px; at most {MOST_FRAME_PIXELS / 1e6:.0f} million pixels are read"
        )
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture
