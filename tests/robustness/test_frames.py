"""Faults of frames from the files on: each is named with its frames, and good frames are not accused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.faults import Fault
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import load_deflectometry, run
from heliogauge.errors import MetrologyError


def said(folder) -> tuple[str, ...]:
    """What the evaluation warns of, without the missing sigmas of every synthetic measurement."""
    result = run(load_deflectometry(folder))
    return tuple(one.text for one in result.doubts if one.code != "sigma_of_setup_missing")


def refused(folder) -> str:
    with pytest.raises(MetrologyError) as caught:
        run(load_deflectometry(folder))
    return str(caught.value)


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


@pytest.mark.parametrize("share", [0.05, -0.03])
def test_slow_drift_is_seen_in_all_frames_together(tmp_path, share):
    """No single frame is off by more than its own uncertainty; 5 % from first to last passed in silence."""
    warnings = said(spoilt(tmp_path / "m", f"drift:{share}"))
    assert len(warnings) == 1
    found = re.search(r"drifts by ([-+.\d]+)% from frame 0 to frame 31", warnings[0])
    # The black level does not drift, so that the change of the readings is smaller than that of the light.
    assert float(found[1]) == pytest.approx(85 * share, rel=0.1)


def test_right_response_is_not_accused(tmp_path):
    """A level is 0 to 1: the noise floor of 0.3 DN made 8 sets 'weak' and a frame 14 % brighter."""
    assert said(spoilt(tmp_path / "m", gamma=2.2)) == ()


def test_response_that_is_cut_off_is_named(tmp_path):
    folder = spoilt(tmp_path / "m", gamma=2.2)
    lines = (folder / "response.csv").read_text().splitlines()
    (folder / "response.csv").write_text("\n".join(lines[: len(lines) // 2]))
    assert "above the brightest one of the response" in refused(folder)


def test_fence_post_steps_are_one_fault(tmp_path):
    """Four steps of 120 instead of 90 deg: 20 lines about swapped and stale frames came before."""
    text = refused(spoilt(tmp_path / "m", "wrong-step"))
    assert "steps 0, 120, 240, 360 deg" in text
    assert "\n" not in text


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


def test_frame_without_its_lower_third_is_damaged_not_stale(tmp_path):
    text = refused(spoilt(tmp_path / "m", "corrupt:3"))
    assert "frame 3" in text
    assert "damaged" in text


@pytest.mark.parametrize("fault", ["repeated:5", "stale:6", "swapped:7"])
def test_single_frames_are_named(tmp_path, fault):
    text = refused(spoilt(tmp_path / "m", fault))
    assert f"frame {fault[-1]} " in text
    assert "\n" not in text
