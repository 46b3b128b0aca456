"""What the templates say of a camera without sigmas is what the evaluation does; its direction is the program's."""

from importlib.resources import files

import pytest

TEMPLATES = ("template.toml", "dots/template_dots.toml", "dots/series/template_series.toml")


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_camera_without_sigmas_is_not_called_exact(name: str) -> None:
    text = files("deflectometry").joinpath(name).read_text(encoding="utf-8")
    assert "exactly known" not in text
    assert "known no better than the images know them" in text
    (line,) = (line for line in text.splitlines() if line.startswith("distortion_direction"))
    ideal, measured = line.split('"measured_to_ideal"')
    assert "OpenCV" in ideal
    assert "AICON" in ideal
    assert "PhotoModeler" in measured
