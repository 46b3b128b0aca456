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
from heliogauge.files.videos import open_video
from heliogauge.images.video_names import FRAME

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
    capture = open_video(video)
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
    rate = float(open_video(video).get(cv2.CAP_PROP_FPS))
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
        reader = _OWN.reader = _Reader(video, open_video(video))
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
