"""What a result rests on: effects of stated inputs against measuring again, and what goes unnoticed."""

from pathlib import Path

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import load_deflectometry, run
from deflectometry.pipeline.result import Result
from heliogauge.doubts import Severity


def measured(folder: Path, *changes: tuple[str, float]) -> Result:
    """Measure with some values of measurement.toml moved; without the key's sigma where the amount is NaN."""
    file = folder / "measurement.toml"
    before = file.read_text()
    lines = before.splitlines()
    for key, amount in changes:
        number = next(i for i, line in enumerate(lines) if line.startswith(f"{key} = "))
        value = float(lines[number].split("=")[1])
        lines[number] = "" if np.isnan(amount) else f"{key} = {value + amount!r}"
    file.write_text("\n".join(lines))
    try:
        return run(load_deflectometry(folder))
    finally:
        file.write_text(before)


@pytest.mark.slow
def test_effects_are_those_of_measuring_again_and_unconfirmed_inputs_are_noted(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    write_dataset(folder, preset_scene("small"), DatasetOptions(1, Knowledge()))
    result = measured(folder)
    inputs = {one.key: one for one in result.inputs}
    before = np.array([result.numbers[f"{name}_per_m"] for name in ("curvature_x", "curvature_y", "twist")])
    for key, name, step, units in (
        ("mirror.distance.distance_m", "distance_m", 4e-3, 4.0),
        ("camera.focal_y_px", "focal_y_px", 0.5, 0.5),
        ("screen.height_m", "height_m", 2e-3, 2.0),
    ):
        again = measured(folder, (name, step)).numbers
        after = np.array([again[f"{one}_per_m"] for one in ("curvature_x", "curvature_y", "twist")])
        one = inputs[key]
        # First order of a change of half a permille, on 400 of the pixels.
        assert after - before == pytest.approx(units * one.changes, abs=0.05 * np.abs(units * one.changes).max())
    note = {one.code: one for one in result.doubts}["inputs_unconfirmed"]
    assert note.severity is Severity.NOTE
    # The test of the distance at 1 % finds 3.86 sigma of the difference nine times of ten; the curl may find less.
    sigma_mm = 1e3 * result.numbers["sigma_distance_from_image_m"]
    distance = inputs["mirror.distance.distance_m"]
    found = 3.86 * np.hypot(sigma_mm, distance.sigma)
    assert 0.8 * found < distance.unnoticed < 1.01 * found
    width = measured(folder, ("sigma_width_mm", np.nan))
    one = inputs["screen.width_m"]
    expected = np.hypot(one.sigma_images, one.off_by_images) * abs(one.changes[0])
    together = np.hypot(expected, result.numbers["sigma_curvature_x_per_m"])
    assert width.numbers["sigma_curvature_x_per_m"] == pytest.approx(together, rel=0.05)
    wide = {one.key: one for one in measured(folder, ("width_m", 0.1)).inputs}["screen.width_m"]
    # The same noise in both. A width makes little curl: a cubic over 400 pixels holds three quarters of it.
    assert 60.0 < wide.off_by_images - one.off_by_images < 140.0
    assert abs(wide.off_by_images - 100.0) < 3 * wide.sigma_images
    tall = {one.key: one for one in measured(folder, ("height_m", 0.05)).inputs}
    assert abs(tall["screen.height_m"].off_by_images - 50.0) < 3 * tall["screen.height_m"].sigma_with_misfit
    assert tall["screen.height_m"].left_by_images < 1.5
    # Whatever width is assumed, most of that curl stays.
    assert tall["screen.width_m"].left_by_images > 3.0
    assert tall["screen.width_m"].sigma_with_misfit > 3.0 * tall["screen.width_m"].sigma_images
