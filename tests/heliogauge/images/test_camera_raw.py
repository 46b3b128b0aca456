"""Camera raw files: values in proportion to the light, the whole raster as the sensor has it, and what is refused."""

import struct
import sys
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.images import photos
from heliogauge.images.photos import read_channel, read_frames, read_image, read_luma

BLACK, WHITE = 64, 4095
#: Photons of a pixel's colour, beside those of green, in light of one colour everywhere.
OF_RED, OF_BLUE = 0.5, 0.8
INNER = np.s_[4:-4, 4:-4]


def dng(values: np.ndarray, orientation: int = 1) -> bytes:
    """Return a DNG file of the values of a sensor with red, green / green, blue filters, not compressed."""
    height, width = values.shape
    data = values.astype("<u2").tobytes()
    short, long = (lambda *v: struct.pack(f"<{len(v)}H", *v)), (lambda *v: struct.pack(f"<{len(v)}I", *v))
    unit = b"".join(struct.pack("<ii", int(row == column), 1) for row in range(3) for column in range(3))
    tags = {
        254: (4, 1, long(0)),
        256: (4, 1, long(width)),
        257: (4, 1, long(height)),
        258: (3, 1, short(16)),
        259: (3, 1, short(1)),
        262: (3, 1, short(32803)),
        271: (2, 5, b"Test\0"),
        272: (2, 5, b"Test\0"),
        273: (4, 1, long(0)),
        274: (3, 1, short(orientation)),
        277: (3, 1, short(1)),
        278: (4, 1, long(height)),
        279: (4, 1, long(len(data))),
        33421: (3, 2, short(2, 2)),
        33422: (1, 4, bytes([0, 1, 1, 2])),
        50706: (1, 4, bytes([1, 4, 0, 0])),
        50707: (1, 4, bytes([1, 1, 0, 0])),
        50708: (2, 5, b"Test\0"),
        50714: (3, 1, short(BLACK)),
        50717: (4, 1, long(WHITE)),
        50721: (10, 9, unit),
        50728: (5, 3, long(1, 2, 1, 1, 4, 5)),
        50778: (3, 1, short(21)),
    }
    base = 8 + 2 + 12 * len(tags) + 4
    blobs = b"".join(value + b"\0" * (len(value) % 2) for _, _, value in tags.values() if len(value) > 4)
    tags[273] = (4, 1, long(base + len(blobs)))
    entries, place = b"", base
    for tag, (kind, count, value) in tags.items():
        inside = value.ljust(4, b"\0") if len(value) <= 4 else long(place)
        place += 0 if len(value) <= 4 else len(value) + len(value) % 2
        entries += struct.pack("<HHI", tag, kind, count) + inside
    return b"II*\0" + long(8) + short(len(tags)) + entries + long(0) + blobs + data


def light(height: int = 48, width: int = 64, brightest: float = 0.55) -> np.ndarray:
    """Light that rises evenly over the raster, 1: what fills a green pixel."""
    y, x = np.mgrid[:height, :width]
    return brightest * (0.1 + 0.9 * (x / width + y / height) / 2)


def sensor(share: np.ndarray) -> np.ndarray:
    filters = np.ones(share.shape)
    filters[::2, ::2], filters[1::2, 1::2] = OF_RED, OF_BLUE
    return np.clip(np.rint(BLACK + (WHITE - BLACK) * share * filters), 0, WHITE)


@pytest.mark.parametrize("brightest", [0.02, 0.55, 0.95])
def test_values_are_in_proportion_to_the_light(brightest: float, tmp_path: Path) -> None:
    """Each colour at each pixel, in DN of 65535; no frame is stretched to its own brightest value."""
    share = light(brightest=brightest)
    (tmp_path / "a.DNG").write_bytes(dng(sensor(share)))
    # Half a step of the sensor, which is 16 DN, and rounding.
    step_dn = 65535 / (WHITE - BLACK)
    for channel, filtered in (("red", OF_RED), ("green", 1.0), ("blue", OF_BLUE)):
        found = read_channel(tmp_path / "a.DNG", channel)
        assert found.dtype == np.uint16
        off = found[INNER].astype(float) - 65535 * filtered * share[INNER]
        assert np.abs(off).max() < 0.5 * step_dn + 2
    grey = read_image(tmp_path / "a.DNG")
    weights = 0.2126 * OF_RED + 0.7152 + 0.0722 * OF_BLUE
    np.testing.assert_allclose(grey[INNER], 65535 * weights * share[INNER], atol=0.5 * step_dn + 2)
    np.testing.assert_array_equal(read_luma(tmp_path / "a.DNG"), grey)


def test_saturated_pixels_are_at_full_scale(tmp_path: Path) -> None:
    share = light()
    share[20:30, 20:30] = 2.5
    (tmp_path / "a.dng").write_bytes(dng(sensor(share)))
    full = read_image(tmp_path / "a.dng") == 65535
    assert full[21:29, 21:29].all()
    assert not full[:18].any()


def test_the_raster_is_that_of_the_sensor_in_stacks_too(tmp_path: Path) -> None:
    for name, orientation in (("a.dng", 1), ("b.dng", 6)):
        (tmp_path / name).write_bytes(dng(sensor(light()), orientation))
    frames = read_frames([tmp_path / "a.dng", tmp_path / "b.dng"])
    assert frames.full_scale_dn == 65535
    assert frames.images_dn.shape == (2, 48, 64)
    np.testing.assert_array_equal(frames.images_dn[0], frames.images_dn[1])
    cv2.imwrite(str(tmp_path / "c.png"), np.zeros((48, 64), np.uint8))
    with pytest.raises(InputError, match="images of one depth"):
        read_frames([tmp_path / "a.dng", tmp_path / "c.png"])


def test_what_is_damaged_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, whole = tmp_path / "a.dng", dng(sensor(light()))
    for content, said in (
        (whole[:-1000], r"a\.dng: the camera raw file is damaged"),
        (whole[:200], r"a\.dng: no camera raw file"),
        # A preview of another program under the name of a raw file.
        (cv2.imencode(".tif", np.zeros((4, 4), np.uint8))[1].tobytes(), r"a\.dng: "),
        (b"not a picture" * 100, r"a\.dng: no camera raw file"),
    ):
        file.write_bytes(content)
        with pytest.raises(InputError, match=said):
            read_image(file)
    file.write_bytes(whole)
    monkeypatch.setattr(photos, "MOST_PIXELS", 1000)
    with pytest.raises(InputError, match="64 x 48 px are 0 million; at most"):
        read_image(file)


def test_without_the_library_the_extra_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.nef").write_bytes(b"II*\0" + bytes(100))
    with (
        patch.dict(sys.modules, {"rawpy": None}),
        pytest.raises(InputError, match=r"rawpy is not installed; camera raw .*heliogauge\[raw\]"),
    ):
        read_image(tmp_path / "a.nef")
