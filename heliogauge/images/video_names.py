"""Names of the frames of a video, without anything that decodes one: measurement.toml is read without OpenCV."""

import re
from pathlib import Path

#: ``pass.mp4#00012``: the thirteenth frame that can be decoded.
FRAME = re.compile(r"(?P<video>.+)#(?P<number>\d{5,})")


def video_of(path: Path) -> Path:
    """Return the file that holds an image.

    path: A photograph or a frame of a video.
    """
    found = FRAME.fullmatch(path.name)
    if found is None or path.exists():
        return path
    video = path.with_name(found["video"])
    return video if video.is_file() else path
