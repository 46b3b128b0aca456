"""Photographs in, photographs out."""

import io
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from heliogauge.errors import InputError
from heliogauge.images.photos import (
    naming_all_unreadable,
    orientation_tag,
    read_channel,
    read_frames,
    read_image,
    read_luma,
    write_image,
)
from heliogauge.running.progress import SilentProgress


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def picture(rng: np.random.Generator, *shape: int, dtype: type = np.uint8) -> np.ndarray:
    return rng.integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


def encoded(suffix: str, image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(suffix, image)[1])


def with_orientation(jpeg: bytes, orientation: int, order: str = "<") -> bytes:
    head = b"II*\x00" if order == "<" else b"MM\x00*"
    tiff = head + struct.pack(order + "IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    segment = b"Exif\x00\x00" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_round_trip_keeps_depth_and_values(tmp_path: Path, rng: np.random.Generator, suffix: str, dtype: type) -> None:
    path = tmp_path / f"Spiegel Ä 1{suffix}"
    image = picture(rng, 7, 5, dtype=dtype)
    write_image(path, image)
    again = read_image(path)
    assert again.dtype == dtype
    np.testing.assert_array_equal(again, image)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colour_becomes_luminance(tmp_path: Path, dtype: type) -> None:
    full = int(np.iinfo(dtype).max)
    half = full // 2
    colours = np.array([[[half, 0, 0], [0, half, 0], [0, 0, half], [half, half, half - 1]]], dtype=dtype)
    write_image(tmp_path / "colour.png", colours)
    grey = read_image(tmp_path / "colour.png")
    assert grey.dtype == np.float32
    # ITU-R BT.709: red, green, blue.
    wanted = [[0.2126 * half, 0.7152 * half, 0.0722 * half, half - 0.0722]]
    np.testing.assert_allclose(grey, wanted, rtol=1e-6)


def test_one_saturated_colour_saturates_the_luminance(tmp_path: Path) -> None:
    write_image(tmp_path / "colour.png", np.array([[[10, 255, 10], [10, 254, 10]]], dtype=np.uint8))
    grey = read_image(tmp_path / "colour.png")
    assert grey[0, 0] == 255
    assert grey[0, 1] < 190


def test_luma_of_a_jpeg_is_that_of_its_colours_in_the_sensors_raster(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 48), np.linspace(0, 1, 32))
    blue, green, red = (np.rint(40 + 180 * one).astype(np.uint8) for one in (x, y, 1 - x))
    jpeg = bytes(cv2.imencode(".jpg", cv2.merge([blue, green, red]), [cv2.IMWRITE_JPEG_QUALITY, 98])[1])
    (tmp_path / "turned.jpg").write_bytes(with_orientation(jpeg, 6))
    luma = read_luma(tmp_path / "turned.jpg")
    assert luma.dtype == np.uint8
    np.testing.assert_allclose(luma, 0.299 * red + 0.587 * green + 0.114 * blue, atol=3)
    (tmp_path / "cut.jpg").write_bytes(jpeg[:-40])
    with pytest.raises(InputError, match="cut off"):
        read_luma(tmp_path / "cut.jpg")


def test_luma_of_other_files_is_what_they_are_read_as(tmp_path: Path, rng: np.random.Generator) -> None:
    write_image(tmp_path / "colour.png", picture(rng, 5, 7, 3))
    write_image(tmp_path / "deep.tif", picture(rng, 5, 7, dtype=np.uint16))
    (tmp_path / "grey.jpg").write_bytes(encoded(".jpg", picture(rng, 16, 16)))
    for name in ("colour.png", "deep.tif", "grey.jpg"):
        luma, image = read_luma(tmp_path / name), read_image(tmp_path / name)
        assert luma.dtype == image.dtype
        np.testing.assert_array_equal(luma, image)


def test_grey_stored_as_colour_is_mono(tmp_path: Path, rng: np.random.Generator) -> None:
    image = picture(rng, 4, 6)
    write_image(tmp_path / "a.png", np.repeat(image[..., None], 3, axis=2))
    again = read_image(tmp_path / "a.png")
    assert again.dtype == np.uint8
    np.testing.assert_array_equal(again, image)


def test_alpha_is_ignored(tmp_path: Path, rng: np.random.Generator) -> None:
    colours = picture(rng, 4, 6, 4)
    (tmp_path / "alpha.png").write_bytes(encoded(".png", colours))
    (tmp_path / "plain.png").write_bytes(encoded(".png", np.ascontiguousarray(colours[..., :3])))
    np.testing.assert_allclose(read_image(tmp_path / "alpha.png"), read_image(tmp_path / "plain.png"))


class TestUnreadable:
    def test_absent(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"absent\.png: there is no such image"):
            read_image(tmp_path / "absent.png")

    def test_folder(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="cannot be read"):
            read_image(tmp_path)

    def test_empty(self, tmp_path: Path) -> None:
        (tmp_path / "empty.png").touch()
        with pytest.raises(InputError, match=r"empty\.png: the file is empty"):
            read_image(tmp_path / "empty.png")

    @pytest.mark.parametrize("name", ["text.png", "text.jpg", "text.tif"])
    def test_not_an_image(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).write_text("no picture at all", encoding="utf-8")
        with pytest.raises(InputError, match=f"{name}: cannot be decoded"):
            read_image(tmp_path / name)

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
    @pytest.mark.parametrize("share", [0.999, 0.6, 0.1])
    def test_cut_off(self, tmp_path: Path, rng: np.random.Generator, suffix: str, share: float) -> None:
        content = encoded(suffix, picture(rng, 100, 100))
        path = tmp_path / f"cut{suffix}"
        path.write_bytes(content)
        assert read_image(path).shape == (100, 100)
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=rf"cut\{suffix}: .*cut off|cannot be decoded"):
            read_image(path)

    def test_cut_off_tiff_with_its_directory_in_front(self, tmp_path: Path, rng: np.random.Generator) -> None:
        buffer = io.BytesIO()
        tifffile.imwrite(buffer, picture(rng, 100, 100))
        path = tmp_path / "cut.tif"
        path.write_bytes(buffer.getvalue())
        assert read_image(path).shape == (100, 100)
        path.write_bytes(buffer.getvalue()[:6000])
        with pytest.raises(InputError, match=r"cut\.tif: "):
            read_image(path)

    def test_cut_off_jpeg_with_a_whole_thumbnail(self, tmp_path: Path, rng: np.random.Generator) -> None:
        """The thumbnail's end marker must not be taken for the photograph's."""
        thumbnail = encoded(".jpg", picture(rng, 8, 8))
        photograph = encoded(".jpg", picture(rng, 64, 64))
        segment = b"Exif\x00\x00" + b"II*\x00" + thumbnail
        whole = photograph[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + photograph[2:]
        path = tmp_path / "a.jpg"
        path.write_bytes(whole + b"appended by a camera")
        assert read_image(path).shape == (64, 64)
        path.write_bytes(whole[:-10])
        with pytest.raises(InputError, match="cut off"):
            read_image(path)

    def test_progressive_jpeg_is_whole_only_with_all_scans(self, tmp_path: Path, rng: np.random.Generator) -> None:
        content = bytes(cv2.imencode(".jpg", picture(rng, 64, 64), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1])
        path = tmp_path / "a.jpg"
        path.write_bytes(content)
        assert read_image(path).shape == (64, 64)
        last_scan = content.rindex(b"\xff\xda")
        path.write_bytes(content[:last_scan])
        with pytest.raises(InputError, match="cut off"):
            read_image(path)

    def test_one_flipped_bit_in_a_png(self, tmp_path: Path, rng: np.random.Generator) -> None:
        content = bytearray(encoded(".png", picture(rng, 50, 50)))
        content[1000] ^= 1
        (tmp_path / "a.png").write_bytes(content)
        with pytest.raises(InputError, match=r"damaged \(checksum of its IDAT part\)"):
            read_image(tmp_path / "a.png")

    def test_floating_point_is_not_a_photograph(self, tmp_path: Path) -> None:
        tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4), np.float32))
        with pytest.raises(InputError, match="float32; 8 or 16 bit"):
            read_image(tmp_path / "a.tif")


class TestFrames:
    def test_order_values_and_progress(self, tmp_path: Path, rng: np.random.Generator) -> None:
        images = picture(rng, 9, 6, 5, dtype=np.uint16)
        paths = [tmp_path / f"{k}.png" for k in range(9)]
        for path, image in zip(paths, images, strict=True):
            write_image(path, image)
        progress = SilentProgress()
        frames = read_frames(paths, progress=progress)
        np.testing.assert_array_equal(frames.images_dn, images)
        assert frames.images_dn.dtype == np.uint16
        assert frames.full_scale_dn == 65535
        assert frames.files == tuple(paths)
        assert list(progress.durations_s) == ["read images"]

    def test_mixed_sizes_name_the_odd_one(self, tmp_path: Path, rng: np.random.Generator) -> None:
        for name, shape in {"a": (4, 5), "b": (4, 6), "c": (4, 5)}.items():
            write_image(tmp_path / f"{name}.png", picture(rng, *shape))
        with pytest.raises(InputError, match=r"one size are needed; 2 of 3 are 5 x 4, but b\.png: 6 x 4"):
            read_frames([tmp_path / f"{name}.png" for name in "abc"])

    def test_mixed_depths_name_the_odd_one(self, tmp_path: Path, rng: np.random.Generator) -> None:
        for name, dtype in {"a": np.uint8, "b": np.uint8, "c": np.uint16}.items():
            write_image(tmp_path / f"{name}.png", picture(rng, 4, 5, dtype=dtype))
        with pytest.raises(InputError, match=r"2 of 3 are 8 bit, but c\.png: 16 bit"):
            read_frames([tmp_path / f"{name}.png" for name in "abc"])

    def test_mono_and_colour_together_are_luminance(self, tmp_path: Path, rng: np.random.Generator) -> None:
        mono, colour = picture(rng, 4, 5), picture(rng, 4, 5, 3)
        write_image(tmp_path / "mono.png", mono)
        write_image(tmp_path / "colour.png", colour)
        frames = read_frames([tmp_path / "mono.png", tmp_path / "colour.png"])
        assert frames.images_dn.dtype == np.float32
        np.testing.assert_array_equal(frames.images_dn[0], mono)

    def test_one_bad_file_is_named(self, tmp_path: Path, rng: np.random.Generator) -> None:
        paths = [tmp_path / f"{k}.png" for k in range(5)]
        for path in paths:
            write_image(path, picture(rng, 4, 5))
        paths[3].write_bytes(b"")
        with pytest.raises(InputError, match=r"3\.png: the file is empty"):
            read_frames(paths)

    def test_nothing_to_read(self) -> None:
        with pytest.raises(InputError, match="at least one file"):
            read_frames([])


class TestOrientation:
    @pytest.mark.parametrize("order", ["<", ">"])
    def test_raster_is_kept_whatever_the_tag_says(self, tmp_path: Path, rng: np.random.Generator, order: str) -> None:
        jpeg = encoded(".jpg", picture(rng, 8, 16))
        turned = with_orientation(jpeg, 6, order)
        assert (orientation_tag(jpeg), orientation_tag(turned)) == (1, 6)
        (tmp_path / "plain.jpg").write_bytes(jpeg)
        (tmp_path / "turned.jpg").write_bytes(turned)
        np.testing.assert_array_equal(read_image(tmp_path / "turned.jpg"), read_image(tmp_path / "plain.jpg"))

    def test_mixture_is_doubtful(self, tmp_path: Path, rng: np.random.Generator) -> None:
        jpeg = encoded(".jpg", picture(rng, 8, 16))
        (tmp_path / "plain.jpg").write_bytes(jpeg)
        (tmp_path / "turned.jpg").write_bytes(with_orientation(jpeg, 6))
        (doubt,) = read_frames([tmp_path / "plain.jpg", tmp_path / "turned.jpg"]).doubts
        assert doubt.code == "orientation_tags_differ"
        assert "turned.jpg: 6" in doubt.text

    def test_one_orientation_is_no_cause_for_doubt(self, tmp_path: Path, rng: np.random.Generator) -> None:
        (tmp_path / "a.jpg").write_bytes(with_orientation(encoded(".jpg", picture(rng, 8, 16)), 3))
        assert read_frames([tmp_path / "a.jpg", tmp_path / "a.jpg"]).doubts == ()

    def test_damaged_tags_say_nothing(self, rng: np.random.Generator) -> None:
        jpeg = with_orientation(encoded(".jpg", picture(rng, 8, 8)), 6)
        start = jpeg.index(b"II*\x00")
        assert orientation_tag(jpeg[: start + 4] + b"\xff\xff\xff\xff" + jpeg[start + 8 :]) == 1


class TestWriting:
    @pytest.mark.parametrize(
        ("name", "image", "wanted"),
        [
            ("a.jpg", np.zeros((2, 2), np.uint8), r"\.png, \.tif or \.tiff"),
            ("a.png", np.zeros((2, 2), np.float32), "uint8 or uint16"),
            ("a.png", np.zeros((2, 2, 2), np.uint8), "shape"),
            ("a.png", np.zeros((0, 2), np.uint8), "shape"),
            ("absent/a.png", np.zeros((2, 2), np.uint8), "cannot be written"),
        ],
    )
    def test_what_cannot_be_written(self, tmp_path: Path, name: str, image: np.ndarray, wanted: str) -> None:
        with pytest.raises(InputError, match=wanted):
            write_image(tmp_path / name, image)
        assert list(tmp_path.iterdir()) == []


def test_one_colour(tmp_path: Path) -> None:
    colours = np.random.default_rng(4).integers(0, 255, (20, 30, 3)).astype(np.uint16) * 200
    write_image(tmp_path / "colour.png", colours)
    for k, name in enumerate(("red", "green", "blue")):
        assert np.array_equal(read_channel(tmp_path / "colour.png", name), colours[..., k])
    write_image(tmp_path / "grey.png", colours[..., 0])
    assert np.array_equal(read_channel(tmp_path / "grey.png", "blue"), colours[..., 0])
    assert np.array_equal(read_channel(tmp_path / "colour.png", "luminance"), read_image(tmp_path / "colour.png"))
    with pytest.raises(InputError, match="channel"):
        read_channel(tmp_path / "colour.png", "infrared")


def test_all_unreadable_photos_are_named_at_once(tmp_path: Path, rng: np.random.Generator) -> None:
    files = [tmp_path / f"{name}.jpg" for name in "abc"]
    whole = encoded(".jpg", picture(rng, 40, 60))
    for file, content in zip(files, (whole, b"", whole[:-2]), strict=True):
        file.write_bytes(content)
    with (
        pytest.raises(InputError, match=r"b\.jpg: the file is empty.*c\.jpg: the JPEG file is cut off.*2 of 3 photos"),
        naming_all_unreadable(files),
    ):
        for file in files:
            read_luma(file)
    # What is no fault of a photo stays what it is.
    with pytest.raises(InputError, match=r"^targets: none$"), naming_all_unreadable(files):
        raise InputError("targets: none")
