"""A wide field: each module has targets of its own in the light of one pass, and stands where the list says."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_synth.troughs.photo import Photographer
from data_synth.troughs.wide_field.dataset import write_wide_field
from data_synth.troughs.wide_field.repeated_pass import MOST_MODULES, RepeatedPass, module_scenes
from heliogauge.errors import InputError
from heliogauge.images.photos import read_luma
from heliogauge.results.json_file import read_json


@pytest.mark.slow
def test_a_module_in_the_light_of_another_looks_as_if_traced_itself() -> None:
    first, second = module_scenes(2, 2)
    view = first.views[0]
    repeated = RepeatedPass(first).over(second).take(view, np.random.default_rng(1)).astype(float)
    traced = Photographer(second).take(view, np.random.default_rng(1)).astype(float)
    other = Photographer(first).take(view, np.random.default_rng(1)).astype(float)
    # Noise is 1 to 2 DN; a code that is another one differs by 150 DN in some hundred pixels.
    assert np.abs(repeated - traced).max() < 20
    assert np.count_nonzero(np.abs(repeated - other) > 60) > 100


@pytest.mark.slow
def test_modules_stand_where_the_list_says_and_photos_show_their_own(tmp_path: Path) -> None:
    write_wide_field(tmp_path / "field", 12, 2)
    content = tomllib.loads((tmp_path / "field" / "measurement.toml").read_text(encoding="utf-8"))
    truth = read_json(tmp_path / "field" / "truth.json")
    places = np.array([one["place_m"] for one in content["module"]])
    stated, true = (np.array(list(truth[name].values())) for name in ("stated_points_m", "points_m"))
    assert list(truth["stated_points_m"]) == list(truth["points_m"])
    assert stated.shape == (144, 3)
    assert 1e-4 < np.abs(stated - true).max() < 6e-3
    own = stated.reshape(12, 12, 3) - places[:, None]
    # Twelve targets about each module's origin, each turned and placed with an error of its own.
    np.testing.assert_allclose(own, np.broadcast_to(own[0], own.shape), atol=1e-9)
    off = (stated - true).reshape(12, 12, 3)
    assert (np.abs(off[1:] - off[0]).max(axis=(1, 2)) > 1e-4).all()
    for number, name in ((0, "photo_000_001.jpg"), (11, "photo_011_001.jpg")):
        position = np.array(truth["photos"][name]["position_m"])
        assert np.abs(position[:2] - places[number, :2]).max() < 4
        assert read_luma(tmp_path / "field" / name).shape == (640, 480)


def test_more_modules_than_codes_are_refused() -> None:
    with pytest.raises(InputError, match=f"at most {MOST_MODULES}"):
        module_scenes(MOST_MODULES + 1, 2)
