"""Plans of screens: what is not determined is named, what is missing is said, alternatives are worth what they must.

That the promise is kept is tested beside the sigmas of measured screens.
"""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deflectometry.planning.pipeline.alternatives import ALTERNATIVES_FILE
from deflectometry.planning.sigma_prospect import SigmaProspect
from deflectometry.report.plan import alternative_tables
from deflectometry.screen_geometry.keys import ScreenGeometryModel
from deflectometry.screen_geometry.planning.plan import PHOTOS_FILE, PlannedScreen
from deflectometry.screen_geometry.planning.predicted_points import predicted
from heliogauge.errors import EstimationError, InputError
from heliogauge.measurement.load import read_measurement
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.folder import read_table_csv, write_table_csv
from heliogauge.running import cli

TOML = """
kind = "screen-geometry"
name = "screen"
measuring_photo = "bench.png"
[[camera]]
name = "survey"
width_px = 1600
height_px = 1200
focal_px = 1750.0
[[camera]]
name = "measuring"
photos = ["bench.png"]
width_px = 1224
height_px = 1024
focal_px = 1800.0
[images]
photos = "*.png"
[targets]
dictionary = "DICT_4X4_50"
[display]
file = "targets.csv"
[[scale_bar]]
a = "0.0"
b = "7.2"
length_m = 1.2
sigma_mm = 0.2
[plan]
width_m = 1.16
height_m = 0.76
sigma_target_px = 0.01
mirror_m = 10.0
fringe_noise_mrad = 0.02
"""
FRONTAL = [[0.1 * x, 0.1 * y, 2.3] for x, y in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]


def planned(folder: Path, **changes: Any) -> PlannedScreen:
    """Write a measurement.toml without photos; changes by tables, None leaves one out."""
    folder.mkdir(exist_ok=True)
    content = tomllib.loads(TOML)
    for table, values in changes.items():
        own = content.get(table)
        content[table] = own | values if isinstance(own, dict) and isinstance(values, dict) else values
    write_measurement(folder, {key: one for key, one in content.items() if one is not None})
    return PlannedScreen(folder, read_measurement(folder, ScreenGeometryModel)[1])


def prospect(folder: Path, **changes: Any) -> SigmaProspect:
    return planned(folder, **changes).prospect()


def codes(found: SigmaProspect) -> set[str]:
    return {one.code for one in found.doubts}


def test_size_is_as_good_as_the_scale_bar(tmp_path: Path) -> None:
    one = planned(tmp_path / "p")
    found, places = one.prospect(), one.surface().places_m()
    sigma, bar = found.sigmas(), float(np.linalg.norm(places["0.0"] - places["7.2"]))
    # 0.2 mm on the bar: of the width in its ratio, and little beside it.
    assert sigma["width_m"] == pytest.approx(2e-4 * 1.16 / bar, rel=0.03)
    # The size alone spreads the screen: a point at x is off by a share of x, its reflection by half of that over 10 m.
    x, y = (np.linspace(-0.5, 0.5, 9) * size for size in (1.16, 0.76))
    spread = np.sqrt(0.5 * (np.mean(x**2) + np.mean(y**2)))
    assert sigma["slope_rms_rad"] == pytest.approx(2e-4 / bar * spread / 20, rel=0.05)
    assert "of the noise of the fringes" in found.texts["slopes"]
    assert codes(found) == {"screen_camera_exact"}


def test_ring_codes_with_a_known_length_between_them(tmp_path: Path) -> None:
    """What such two err by is all shared with the others: nothing is their own."""
    bar = {"a": "0", "b": "7", "length_m": 1.2, "sigma_mm": 0.2}
    rings = prospect(tmp_path / "p", targets={"dictionary": "aicon-12"}, scale_bar=[bar])
    assert rings.sigmas()["width_m"] == pytest.approx(prospect(tmp_path / "q").sigmas()["width_m"], rel=0.03)


def test_photos_from_the_front_are_named(tmp_path: Path) -> None:
    found = prospect(tmp_path / "p", plan={"places_m": FRONTAL})
    (doubt,) = [one for one in found.doubts if one.code == "plan_photos_from_one_side"]
    # 0.1 m either way at 2.3 m.
    assert doubt.numbers["angle_deg"] == pytest.approx(2 * np.degrees(np.arctan(0.1 / 2.3)), rel=1e-6)
    all_round = prospect(tmp_path / "q")
    assert "plan_photos_from_one_side" not in codes(all_round)
    assert all_round.sigmas()["z_m"] < 0.7 * found.sigmas()["z_m"]


def test_photos_that_do_not_hang_together_are_refused(tmp_path: Path) -> None:
    cameras = tomllib.loads(TOML)["camera"]
    del cameras[0]["focal_px"]
    with pytest.raises(EstimationError, match=r"as planned, measuring would be refused .*taken from one place"):
        prospect(tmp_path / "p", plan={"places_m": FRONTAL}, camera=cameras)


def test_photos_that_show_too_little_are_named(tmp_path: Path) -> None:
    places = [[1.5, 0.8, 2.0], [-1.5, 0.8, 2.0], [0.0, -1.7, 2.0], [0.0, 0.0, 0.3]]
    (doubt,) = [one for one in prospect(tmp_path / "p", plan={"places_m": places}).doubts if "unused" in one.code]
    assert doubt.numbers["photos_count"] == 1
    assert "photo_4" in doubt.text


def test_lengths_that_are_kept_apart_give_no_size(tmp_path: Path) -> None:
    bars = [{"a": "0.0", "b": "7.2", "length_m": 1.2, "sigma_mm": 0.2, "check_only": True}]
    found = prospect(tmp_path / "p", scale_bar=bars)
    assert "scale_missing" in codes(found)
    assert found.not_determined["width_m"] == "there is no scale"
    assert {name for name, one in found.sigmas().items() if np.isfinite(one)} == {"camera_rotation_rad"}


def test_default_places_show_all_targets(tmp_path: Path) -> None:
    one = planned(tmp_path / "p", measuring_photo=None, camera=tomllib.loads(TOML)["camera"][:1])
    seen = predicted(one.surface(), one.photos()).targets.points
    assert len(seen.photos) == 8
    assert seen.n == 8 * 14 * 4


def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"\[plan\] is missing; give width_m and height_m"):
        prospect(tmp_path / "a", plan=None)
    with pytest.raises(InputError, match=r"names target '77\.0', which is not planned"):
        prospect(tmp_path / "b", scale_bar=[{"a": "77.0", "b": "7.2", "length_m": 1.2, "sigma_mm": 0.2}])
    with pytest.raises(InputError, match="camera survey: width_px and height_px are needed"):
        prospect(tmp_path / "c", camera=[{"name": "survey"}, *tomllib.loads(TOML)["camera"][1:]])
    with pytest.raises(EstimationError, match="no photo will show a target of 60 mm"):
        prospect(tmp_path / "e", plan={"width_m": 6.0, "height_m": 6.0})
    planned(tmp_path / "d", plan={"places_m": [[40.0, 0.0, 0.1], [0.0, 40.0, 0.1]]})
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(tmp_path / "d"), "-o", str(tmp_path / "out"), "--no-report", "-q"])
    assert ended.value.code == 2
    assert "as planned, measuring would be refused" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_too_few_dots_to_number_are_refused(tmp_path: Path) -> None:
    """Of two by two, numbers of missing dots ran away, and memory did not suffice for them."""
    with pytest.raises(EstimationError, match="shows 2 columns and 2 rows of dots; 4 of each are needed"):
        prospect(tmp_path / "p", display=None, dots={"origin": "corner"}, plan={"columns": 2, "rows": 2})


def test_the_measuring_photo_is_none_of_the_places(tmp_path: Path) -> None:
    (change,) = [one for one in planned(tmp_path / "p").changes() if one.key == "plan.places_m"]
    assert (change.before, change.after) == ("8 photos", "9 photos")


def test_tables_of_older_plans_are_reported(tmp_path: Path) -> None:
    rows = {"change": ["as planned", "nearer"], "gain_z_m": [1.0, 1.5], "reason": ["", ""]}
    write_table_csv(tmp_path / ALTERNATIVES_FILE, rows)
    assert "1.50" in alternative_tables(tmp_path, {"z_m": "depth"}, {}).text


@pytest.mark.slow
def test_alternatives_and_report(tmp_path: Path) -> None:
    planned(tmp_path / "p")
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(tmp_path / "p"), "-o", str(out), "-q"])
    assert ended.value.code == 0
    table = read_table_csv(out / ALTERNATIVES_FILE, ("key", "gain_width_m", "gain_z_m", "gain_camera_rotation_rad"))
    width, depth, turn = (
        dict(zip(table["key"], map(float, table[f"gain_{name}"]), strict=True))
        for name in ("width_m", "z_m", "camera_rotation_rad")
    )
    assert width["scale_bar.sigma_mm"] == pytest.approx(2.0, rel=0.1)
    assert depth["plan.sigma_target_px"] == pytest.approx(2.0, rel=0.02)
    assert 1.05 < depth["plan.places_m"] < 1.5
    assert turn["targets"] == pytest.approx(np.sqrt(2), rel=0.1)
    assert len(read_table_csv(out / PHOTOS_FILE, ("photo",))["photo"]) == 9
    assert "Where the photos are taken" in (out / "report.html").read_text()
