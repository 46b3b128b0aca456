"""A measured screen in a deflectometry measurement: the same slopes, and its errors as common modes."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_synth.fringes import DatasetOptions, preset_scene, write_dataset
from data_synth.fringes.presets import STANDARD_PLACE_M as PLACE_M
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.inputs import build_setup
from deflectometry.pipeline.measure import run
from deflectometry.screen_geometry.measured_screen import MeasuredScreen
from deflectometry.screen_geometry.pipeline.screen_file import write_screen
from deflectometry.setup.smooth_screen import SharedStep, SmoothScreen, SmoothWarp
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import dump_toml

pytestmark = pytest.mark.slow

#: Relative error of the screen's width, 1 sigma.
_WIDER = 1e-3


def _with_measured_screen(folder: Path, *, with_pose: bool = True) -> None:
    """Put a measured screen in the place of the rectangle, its width uncertain by one per mille."""
    file = folder / "measurement.toml"
    content = tomllib.loads(file.read_text())
    stated = content["screen"]
    surface, wider = np.zeros((3, 3)), np.zeros((3, 3))
    surface[1, 0], surface[2, 1] = 0.5 * stated["width_m"], -0.5 * stated["height_m"]
    wider[1, 0] = _WIDER * surface[1, 0]
    pose = RigidTransform.from_rotation_vector(stated["rotation_vector_rad"], stated["translation_m"])
    shared = (SharedStep(np.zeros(6), SmoothWarp(wider)),)
    measured = MeasuredScreen(SmoothScreen(surface, form="plane"), shared, pose if with_pose else None)
    write_screen(folder / "screen.nc", measured, "screen")
    file.write_text(dump_toml(content | {"screen": {"shape": "measured", "file": "screen.nc"}}))


def test_slopes_stay_and_the_width_is_in_their_sigmas(tmp_path: Path) -> None:
    write_dataset(tmp_path, preset_scene("small"), DatasetOptions(1))
    before = run(load_deflectometry(tmp_path)).summarise().numbers
    _with_measured_screen(tmp_path)
    after = run(load_deflectometry(tmp_path)).summarise().numbers
    f_x, sigma_x = (float(after[key] or 0.0) for key in ("focal_length_x_m", "sigma_focal_length_x_m"))
    assert after["sdx_rad"] == pytest.approx(before["sdx_rad"], abs=1e-8)
    # Where x on the mirror runs by dx, the point seen on a screen at d runs by (2 - d/f) dx; a screen wider by w turns
    # the normals by half of w times that over d, so 1/f changes by w (2/d - 1/f).
    distance_m = float(np.linalg.norm(PLACE_M))
    assert sigma_x / (f_x**2 * _WIDER * (2 / distance_m - 1 / f_x)) == pytest.approx(1.0, abs=0.15)
    # The height is none of it.
    assert after["sigma_focal_length_y_m"] == pytest.approx(before["sigma_focal_length_y_m"], rel=0.05)


def test_a_screen_without_a_pose_is_refused(tmp_path: Path) -> None:
    write_dataset(tmp_path, preset_scene("small"), DatasetOptions(1))
    _with_measured_screen(tmp_path, with_pose=False)
    with pytest.raises(InputError, match="no photo of the measuring camera"):
        build_setup(load_deflectometry(tmp_path))
