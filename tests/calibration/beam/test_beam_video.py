"""A video of a beam: its frames are measured as photos are."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.beam.cli import app
from heliogauge.images.photos import read_channel
from tests.calibration.beam_pictures import gaussian, sky_light

PLACES = [(0.2, 0.1), (0.5, -0.3), (-0.6, 0.4), (1.1, 0.0)]


def rows(folder: Path, photos: str) -> list[dict[str, str]]:
    (folder / "measurement.toml").write_text(
        f'kind = "beam"\nname = "moving"\n[photos]\n{photos}\n[[target]]\nname = "white"\nwidth_m = 8.0\n'
        'height_m = 7.0\n[[images]]\ntarget = "white"\nwhole = "edge"\n'
    )
    out = folder.with_name(f"out-{len(photos)}")
    done = CliRunner().invoke(app, ["measure", str(folder), "-o", str(out), "--no-report", "-q"])
    assert done.exit_code == 0, done.output
    with (out / "beams.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    home = tmp_path / "m"
    home.mkdir()
    # Lossless, so that frames are the photos.
    video = cv2.VideoWriter(str(home / "beam.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 5, (256, 224))
    if not video.isOpened():
        pytest.skip("OpenCV has no FFV1 here")
    for number, place in enumerate(PLACES):
        light = sky_light() + 90 * gaussian(place) + np.random.default_rng(number).normal(0, 1, (224, 256))
        grey = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        colour = np.stack([grey // 2, grey, grey // 3], axis=-1)
        video.write(colour)
        cv2.imwrite(str(home / f"{number}.png"), colour)
    video.release()
    return home


def test_frames_are_measured_as_photos(folder: Path) -> None:
    frames, photos = rows(folder, 'video = "beam.avi"'), rows(folder, 'photos = "*.png"')
    places = [np.array([[float(one["x_m"]), float(one["y_m"])] for one in found]) for found in (frames, photos)]
    # FFV1 of OpenCV keeps colours to a grey level or two.
    assert places[0] == pytest.approx(places[1], abs=2e-3)
    assert places[0] == pytest.approx(np.array(PLACES), abs=0.02)
    assert len(rows(folder, 'video = "beam.avi"\nevery_nth = 2')) == 2


def test_one_colour_of_a_frame(folder: Path) -> None:
    still, frame = (read_channel(folder / name, "green") for name in ("2.png", "beam.avi#00002"))
    assert frame.shape == still.shape
    assert np.abs(frame.astype(int) - still.astype(int)).mean() < 2
    red = read_channel(folder / "beam.avi#00002", "red").astype(float)
    assert red.mean() == pytest.approx(still.mean() / 3, rel=0.05)
