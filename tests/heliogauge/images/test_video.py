"""Frames of videos as photographs: each by its number in whatever order, copies left out, damage said."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.images.photos import read_image, write_image
from heliogauge.images.video import list_frames
from heliogauge.images.video_names import video_of

SIZE = (96, 64)
FORMATS = [("pass.avi", "MJPG"), ("Überflug 1.mp4", "mp4v")]


def shade(number: int) -> int:
    return 20 + 9 * number


def film(file: Path, code: str, numbers: list[int]) -> Path:
    """Write frames that are as grey as their number says."""
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*code), 25, SIZE)
    for number in numbers:
        writer.write(np.full((SIZE[1], SIZE[0], 3), shade(number), dtype=np.uint8))
    writer.release()
    return file


@pytest.mark.parametrize(("name", "code"), FORMATS)
def test_each_frame_by_its_number_in_any_order(tmp_path, name, code):
    video = film(tmp_path / name, code, list(range(20)))
    frames = list_frames(video)
    assert [file.name for file in frames.files] == [f"{name}#{k:05d}" for k in range(20)]
    assert frames.doubts == ()
    for number in (3, 4, 4, 12, 2, 19, 0):
        image = read_image(frames.files[number])
        assert image.dtype == np.uint8
        assert image.shape == SIZE[::-1]
        assert np.median(image) == pytest.approx(shade(number), abs=3)


def test_threads_have_their_own_place_in_the_video(tmp_path):
    video = film(tmp_path / "pass.avi", "MJPG", list(range(24)))
    files = list_frames(video).files
    with ThreadPoolExecutor(3) as pool:
        shades = list(pool.map(lambda file: np.median(read_image(file)), files))
    assert shades == pytest.approx([shade(k) for k in range(24)], abs=3)


def test_every_nth_begins_with_the_first(tmp_path):
    video = film(tmp_path / "pass.avi", "MJPG", list(range(10)))
    names = [file.name for file in list_frames(video, every_nth=4).files]
    assert names == ["pass.avi#00000", "pass.avi#00004", "pass.avi#00008"]


def test_copies_are_left_out_and_said(tmp_path):
    """A recorder that lost frames repeats others: the same noise twice would count as two measurements."""
    video = film(tmp_path / "pass.avi", "MJPG", [0, 1, 1, 1, 2])
    frames = list_frames(video)
    assert [file.name[-1] for file in frames.files] == ["0", "1", "4"]
    assert "2 frames are exact copies" in frames.doubts[0].text


def test_video_cut_off(tmp_path):
    video = film(tmp_path / "pass.avi", "MJPG", list(range(20)))
    content = video.read_bytes()
    # The list of streams fills the first kilobytes.
    start = content.index(b"movi")
    video.write_bytes(content[: (start + len(content)) // 2])
    frames = list_frames(video)
    assert 5 < len(frames.files) < 20
    assert "of the 20 frames that it claims to have" in frames.doubts[0].text


@pytest.mark.parametrize("content", [b"", b"this is no video" * 50])
def test_unreadable_video(tmp_path, content):
    video = tmp_path / "pass.mp4"
    video.write_bytes(content)
    with pytest.raises(InputError, match=r"pass.mp4: cannot be opened as a video \(\d+ bytes\)"):
        list_frames(video)


def test_frame_that_is_not_there(tmp_path):
    video = film(tmp_path / "pass.avi", "MJPG", list(range(3)))
    with pytest.raises(InputError, match="frame 7 cannot be decoded"):
        read_image(tmp_path / "pass.avi#00007")
    # The reader has no memory of its failure.
    assert np.median(read_image(list_frames(video).files[1])) == pytest.approx(shade(1), abs=3)


def test_photograph_with_such_a_name_is_a_photograph(tmp_path):
    """A sharp and five digits do not make a file a video."""
    image = np.full((4, 5), 77, dtype=np.uint8)
    write_image(tmp_path / "a.png", image)
    (tmp_path / "a.png").rename(tmp_path / "a.png#00001")
    assert video_of(tmp_path / "a.png#00001") == tmp_path / "a.png#00001"
    assert np.array_equal(read_image(tmp_path / "a.png#00001"), image)
