"""Faults of frames from the files on: each is named with its frames, and good frames are not accused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.faults import Fault
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import Options, load_deflectometry, run
from deflectometry.setup import make_pattern
from heliogauge.errors import MetrologyError
from heliogauge.slopes.statistics import fit_quadratic


def said(folder) -> tuple[str, ...]:
    """What the evaluation warns of, without the missing sigmas of every synthetic measurement."""
    result = run(load_deflectometry(folder))
    return tuple(one.text for one in result.doubts if one.code not in ("sigma_of_setup_missing", "inputs_unconfirmed"))


def refused(folder) -> str:
    """What a strict evaluation says."""
    with pytest.raises(MetrologyError) as caught:
        run(load_deflectometry(folder), Options(strict=True))
    return str(caught.value)


def mended(folder) -> tuple[str, ...]:
    """Codes of what was mended, after the numbers were held against the truth of the best focus within 4 sigma.

    Without the note of inputs that nothing confirms, which every sound measurement may have.
    """
    result = run(load_deflectometry(folder))
    nodes = result.assembled_as_measured
    x_m, y_m = np.meshgrid(nodes.x_m, nodes.y_m)
    _, slope_x, slope_y = preset_scene("small").facets[0].surface(x_m, y_m)
    seen = nodes.valid
    true = replace(nodes, slope_x=np.where(seen, slope_x, np.nan), slope_y=np.where(seen, slope_y, np.nan))
    found, exact = fit_quadratic(nodes), fit_quadratic(true)
    off = (found.coefficients - exact.coefficients)[[0, 1, 4]] / np.sqrt(np.diag(found.covariance))[[0, 1, 4]]
    assert np.abs(off).max() < 4
    return tuple(one.code for one in result.doubts if one.code != "inputs_unconfirmed")


def spoilt(folder, *faults, noise_dn=1.0, **lighting):
    scene = preset_scene("small")
    scene = replace(
        scene,
        faults=tuple(Fault.parse(text) for text in faults),
        lighting=replace(scene.lighting, **lighting),
        sensor=replace(scene.sensor, read_noise_dn=noise_dn),
    )
    write_dataset(folder, scene, DatasetOptions(0, Knowledge(response=bool(lighting)), force=True))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.05, -0.03])
def test_slow_drift_is_seen_in_all_frames_together(tmp_path, share):
    """No single frame is off by more than its own uncertainty; 5 % from first to last passed in silence."""
    warnings = said(spoilt(tmp_path / "m", f"drift:{share}"))
    assert len(warnings) == 1
    found = re.search(r"drifts by ([-+.\d]+)%", warnings[0])
    assert float(found[1]) == pytest.approx(100 * share, rel=0.05)


@pytest.mark.slow
def test_right_response_is_not_accused(tmp_path):
    """A level is 0 to 1: the noise floor of 0.3 DN made 8 sets 'weak' and a frame 14 % brighter."""
    assert said(spoilt(tmp_path / "m", gamma=2.2)) == ()


def test_response_that_is_cut_off_is_named(tmp_path):
    folder = spoilt(tmp_path / "m", gamma=2.2)
    lines = (folder / "response.csv").read_text().splitlines()
    (folder / "response.csv").write_text("\n".join(lines[: len(lines) // 2]))
    assert "above the brightest one of the response" in refused(folder)


@pytest.mark.slow
def test_fence_post_steps_are_one_fault(tmp_path):
    """Four steps of 120 instead of 90 deg: 20 lines about swapped and stale frames came before."""
    text = refused(spoilt(tmp_path / "m", "wrong-step"))
    assert "steps 0, 120, 240, 360 deg" in text
    assert "\n" not in text
    assert mended(tmp_path / "m") == ("fringe_steps_corrected",)


def test_reversed_steps_are_one_fault(folder, rewrite):
    rewrite(folder, ("steps_deg = .*", "steps_deg = [0.0, 270.0, 180.0, 90.0]"))
    text = refused(folder)
    assert "steps of the opposite sign" in text
    assert "\n" not in text


def test_many_faults_are_shortened(folder):
    names = [f"fringe_{number:02d}.png" for number in range(32)]
    content = [(folder / name).read_bytes() for name in names]
    for name, number in zip(names, np.random.default_rng(1).permutation(32), strict=True):
        (folder / name).write_bytes(content[number])
    text = refused(folder)
    assert text.count("\n") <= 5
    assert "order of the images" in text


@pytest.mark.slow
def test_frame_without_its_lower_third_is_damaged_not_stale(tmp_path):
    text = refused(spoilt(tmp_path / "m", "corrupt:3"))
    assert "frame 3" in text
    assert "damaged" in text
    assert mended(tmp_path / "m") == ("frames_left_out",)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "code"),
    [("repeated:5", "frames_left_out"), ("stale:6", "frames_left_out"), ("swapped:7", "frames_reordered")],
)
def test_single_frames_are_named_and_mended(tmp_path, fault, code):
    text = refused(spoilt(tmp_path / "m", fault))
    assert f"frame {fault[-1]} " in text
    assert "\n" not in text
    assert mended(tmp_path / "m") == (code,)


@pytest.mark.slow
def test_periods_that_one_set_has_otherwise_are_found(folder, rewrite):
    """64 declared, 63.9 shown: the focus was wrong by 16 sigma without a word."""
    rewrite(folder, ("periods = 63.9", "periods = 64.0"))
    assert set(mended(folder)) == {"fringe_periods_corrected"}


@pytest.mark.slow
def test_size_of_the_screen_without_a_sigma_is_a_doubt_and_with_one_a_mode(folder, rewrite):
    """1 % of width is 15 m of 90 m focal length; neither could be said."""
    rewrite(folder, ("sigma_width_mm = .*", "sigma_width_mm = 8.0"))
    numbers = run(load_deflectometry(folder)).numbers
    # By hand: the mirror (f = 90 m, 9.65 m from the camera, d = 10.27 m from the screen) sees 1 + d / 9.65 - d / 90
    # times its own width of the screen; a share of it too much turns the normal by half of that over d.
    width_m, d_m = 8.727, 10.27
    curvature = 8e-3 / width_m * (1 + d_m / 9.65 - d_m / 90) / d_m
    assert numbers["sigma_focal_length_x_m"] == pytest.approx(90.0**2 * curvature, rel=0.1)
    rewrite(folder, ("sigma_width_mm = .*\n", ""), ("sigma_height_mm = .*\n", ""))
    assert "screen_size_exact" in {one.code for one in run(load_deflectometry(folder)).doubts}


@pytest.mark.slow
@pytest.mark.parametrize("noise_dn", [1.0, 6.0])
def test_whole_periods_four_times_finer_each_are_unwrapped(tmp_path, noise_dn):
    """1, 4, 16 and 64 periods: only at the display's very edges the order is open; it is decided by odds of 1e6."""
    scene = preset_scene("small")
    scene = replace(
        scene,
        pattern=make_pattern((1, 4, 16, 64), (1, 4, 16, 64)),
        sensor=replace(scene.sensor, read_noise_dn=noise_dn),
    )
    write_dataset(tmp_path / "m", scene, DatasetOptions(0, Knowledge(), force=True))
    assert mended(tmp_path / "m") == ()


def test_a_set_of_other_periods_is_not_only_called_damaged(folder, rewrite):
    """63.9 shown, 64.9 stated for all: frames 12 to 15 were "damaged" and 28 to 31 "in another order"."""
    rewrite(folder, ("periods = 63.9", "periods = 64.9"))
    named = [text for text in said(folder) if "[[pattern.set]]" in text]
    assert any("12 to 15" in text for text in named)
    assert any("28 to 31" in text for text in named)


def test_dark_and_bright_exchanged_are_named(folder):
    dark, bright = folder / "dark.png", folder / "bright.png"
    dark.rename(folder / "other.png")
    bright.rename(dark)
    (folder / "other.png").rename(bright)
    assert "exchange the two" in refused(folder)
