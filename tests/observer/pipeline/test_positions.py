"""The drone's own positions check the list of targets, from measurement.toml to the finding."""

from pathlib import Path

import numpy as np
import pytest

from data_synth.troughs import TroughChoice, TroughOptions, trough_scene, write_trough_dataset
from heliogauge.errors import InputError
from heliogauge.measurement.load import load
from heliogauge.results.json_file import read_json
from heliogauge.running.progress import SilentProgress
from observer.pipeline.inputs import read_inputs
from photogrammetry.pipeline import Result, run

SIGMA_MM = 20.0


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("positions") / "flight"
    write_trough_dataset(folder, trough_scene("small", TroughChoice(3, n_photos=8)), TroughOptions(3))
    toml = folder / "measurement.toml"
    toml.write_text(toml.read_text() + f'\n[positions]\nfile = "positions.csv"\nsigma_mm = {SIGMA_MM}\n')
    return folder


def positioned(folder: Path, size: float) -> Result:
    """Write positions of the photos, ``size`` times as far from each other as they are, and adjust the network."""
    rng = np.random.default_rng(5)
    photos = read_json(folder / "truth.json")["photos"]
    lines = ["image,east_m,north_m,up_m"]
    for name, photo in photos.items():
        x, y, z = size * np.array(photo["position_m"]) + 1e-3 * SIGMA_MM * rng.standard_normal(3)
        # The row of troughs runs from south to north.
        lines.append(f"{name},{x + 10:.4f},{y - 20:.4f},{z + 100:.4f}")
    (folder / "positions.csv").write_text("\n".join(lines) + "\n")
    return run(read_inputs(load(folder), SilentProgress()).survey)


@pytest.mark.slow
def test_positions_confirm_or_contradict_the_list(flight: Path) -> None:
    right = positioned(flight, 1.0)
    numbers = right.summarise().numbers
    ratio, sigma = numbers["positions_scale_ratio"], numbers["sigma_positions_scale_ratio"]
    assert ratio is not None
    assert sigma is not None
    # Eight photos over 5.8 m at 20 mm: 20 mm / sqrt(sum of squares), and the list's own millimetres.
    assert 0.002 < sigma < 0.008
    assert abs(ratio - 1) < 3 * sigma
    assert "positions_contradict_scale" not in {one.code for one in right.doubts}
    wrong = positioned(flight, 1.04)
    [doubt] = [one for one in wrong.doubts if one.code == "positions_contradict_scale"]
    assert doubt.numbers["positions_scale_ratio"] == pytest.approx(1.04 * ratio, rel=1e-2)


@pytest.mark.slow
def test_a_drawn_flight_with_rtk_is_confirmed(tmp_path: Path) -> None:
    scene = trough_scene("small", TroughChoice(4, n_photos=8))
    write_trough_dataset(tmp_path / "rtk", scene, TroughOptions(4, rtk_sigma_m=0.02))
    found = run(read_inputs(load(tmp_path / "rtk"), SilentProgress()).survey).positions
    assert found is not None
    assert found.photos == 8
    assert abs(found.ratio - 1) < 3 * found.sigma_ratio < 0.03
    # Chi-square of 17 over 17: 1 +- 0.17.
    assert 0.5 < found.misfit < 1.5


@pytest.mark.slow
def test_positions_that_are_not_there_are_named(flight: Path) -> None:
    (flight / "positions.csv").unlink(missing_ok=True)
    with pytest.raises(InputError, match=r"positions\.csv"):
        load(flight)
