"""A drone's log by time: places and turns between its lines, sigmas by the clock, and what is wrong with it."""

from pathlib import Path

import numpy as np
import pytest

from heliogauge.errors import InputError
from photogrammetry.exchange.position_log import LogClock, read_position_log

#: 4 m/s eastwards, yaw through north.
LOG = """time,east_m,north_m,up_m,yaw_deg,pitch_deg,roll_deg
2026-05-04 10:00:00.0,0,5,30,358,-90,0
2026-05-04 10:00:00.5,2,5,30,2,-90,0
2026-05-04 10:00:01.0,4,5,30,6,-90,0
"""


def photo(path: Path, taken: str, fraction: str = "") -> Path:
    """Write the beginning of a JPEG that says when it was taken."""
    texts = [(0x9003, taken), *([(0x9291, fraction)] if fraction else [])]
    start = 26 + 2 + 12 * len(texts) + 4
    inner, tail = len(texts).to_bytes(2, "little"), b""
    for tag, text in texts:
        content = text.encode() + b"\x00"
        value = content.ljust(4, b"\x00") if len(content) <= 4 else (start + len(tail)).to_bytes(4, "little")
        inner += tag.to_bytes(2, "little") + b"\x02\x00" + len(content).to_bytes(4, "little") + value
        tail += content if len(content) > 4 else b""
    first = b"\x01\x00\x69\x87\x04\x00\x01\x00\x00\x00" + (26).to_bytes(4, "little") + bytes(4)
    path.write_bytes(b"\xff\xd8\xff\xe1\x00\xffExif\x00\x00II*\x00\x08\x00\x00\x00" + first + inner + bytes(4) + tail)
    return path


def test_places_between_the_lines_of_a_log(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    # The camera's clock is 10 s ahead.
    sharp = photo(tmp_path / "a.jpg", "2026:05:04 10:00:10", "25")
    whole = photo(tmp_path / "b.jpg", "2026:05:04 10:00:10")
    late = photo(tmp_path / "c.jpg", "2026:05:04 10:00:12")
    found = read_position_log(log, [sharp, whole, late], 0.02, LogClock("time", 10.0, 0.01))
    assert found.photos == ("a.jpg", "b.jpg")
    np.testing.assert_allclose(found.enu_m, [[1.0, 5.0, 30.0], [2.0, 5.0, 30.0]])
    np.testing.assert_allclose(found.turns_deg[0], [360.0, -90.0, 0.0])
    # 2 m/s^2 bend half a second by 62.5 mm; 4 m/s for 10 ms are 40 mm, for a whole second's 0.29 s 1.15 m.
    across = float(np.hypot(0.02, 0.0625))
    np.testing.assert_allclose(found.sigma_m[0], [np.hypot(across, 0.04), across, across])
    assert found.sigma_m[1, 0] == pytest.approx(4 / np.sqrt(12), rel=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("10:00:00.5", "09:00:00.5"), "one after the other in time"),
        ((",2,5,30", ",x,5,30"), "line 3, east_m: 'x' is not a number"),
        (("east_m", "x_m"), "columns latitude_deg, longitude_deg, altitude_m or east_m, north_m, up_m are needed"),
        (("2026-05-04 10:00:01.0", "soon"), "'soon' is not a time like"),
    ],
)
def test_bad_logs_are_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    log = tmp_path / "log.csv"
    log.write_text(LOG.replace(*change))
    one = photo(tmp_path / "a.jpg", "2026:05:04 10:00:00", "25")
    with pytest.raises(InputError, match=message):
        read_position_log(log, [one], 0.02, LogClock("time", 0.0, 0.0))


def test_photos_of_another_hour_or_without_a_time_are_refused(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    one = photo(tmp_path / "a.jpg", "2026:05:04 12:00:00", "25")
    with pytest.raises(InputError, match="is time_offset_s right, or the clock's zone"):
        read_position_log(log, [one], 0.02, LogClock("time", 0.0, 0.0))
    (tmp_path / "b.jpg").write_bytes(b"\xff\xd8")
    with pytest.raises(InputError, match=r"b\.jpg: it does not say when it was taken"):
        read_position_log(log, [tmp_path / "b.jpg"], 0.02, LogClock("time", 0.0, 0.0))
