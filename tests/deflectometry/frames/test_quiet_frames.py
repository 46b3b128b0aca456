"""Frames without noise: what the model of the frames leaves of them is no fault of theirs."""

from dataclasses import replace
from pathlib import Path

import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.presets import preset_scene
from deflectometry import load_deflectometry, run


@pytest.mark.slow
@pytest.mark.parametrize(("bits", "noise_dn"), [(16, 0.0), (16, 5.0), (12, 0.0), (12, 1.0)])
def test_quiet_frames_are_not_mended(tmp_path: Path, bits: int, noise_dn: float) -> None:
    scene = preset_scene("small")
    sensor = replace(scene.sensor, bits=bits, read_noise_dn=noise_dn, shot_gain_dn=0.0)
    write_dataset(tmp_path / "m", replace(scene, sensor=sensor), DatasetOptions(seed=2))
    result = run(load_deflectometry(tmp_path / "m"))
    assert not {one.code for one in result.doubts if one.code.startswith(("frame", "light", "flicker"))}
    assert not any("frame" in one.text for one in result.doubts)
