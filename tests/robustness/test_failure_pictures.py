"""What a measurement that fails leaves: the pictures in which nothing was found."""

import shutil

import cv2
import numpy as np
import pytest

import heliogauge as hg
from heliogauge.errors import EstimationError


def spoil(folder, change):
    for file in sorted(folder.rglob("*.png")):
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), change(image))


@pytest.mark.slow
def test_frames_without_contrast_are_shown(folder, tmp_path):
    rng = np.random.default_rng(1)
    spoil(folder, lambda image: rng.normal(100, 1, image.shape).clip(0, 255).astype(image.dtype))
    with pytest.raises(EstimationError, match=r"what was seen: .*why\.html"):
        hg.measure(folder, tmp_path / "out")
    left = tmp_path / "out-failed"
    assert not (tmp_path / "out").exists()
    names = sorted(file.name for file in left.iterdir())
    assert names[0] == "01-contrast-of-the-fringes.jpg"
    assert "why.html" in names
    assert "brightest minus darkest frame" in (left / "why.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_photos_without_targets_are_shown(tmp_path):
    folder = hg.synth("photogrammetry", tmp_path / "m")
    photos = [file for file in folder.rglob("*") if file.suffix in (".png", ".jpg")]
    for number, file in enumerate(photos):
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), np.full_like(image, 120 + number))
    with pytest.raises(EstimationError, match=r"what was seen: .*why\.html"):
        hg.measure(folder, tmp_path / "out")
    text = (tmp_path / "out-failed" / "why.html").read_text(encoding="utf-8")
    assert "0 named targets" in text
    assert photos[0].name in text
    shutil.rmtree(tmp_path / "m")
