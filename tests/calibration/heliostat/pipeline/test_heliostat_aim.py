"""Readings for a day and a target, and back: the table of a calibration on disk."""

import datetime
import json
from pathlib import Path

import numpy as np
import pytest

from calibration.heliostat.exports.forecast import SkyForecast
from calibration.heliostat.files.store_heliostat import read_heliostat
from calibration.heliostat.fitting.prediction import predict_aim
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline import aim, curves
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.pipeline.measure import run as calibrate
from calibration.heliostat.planning.error_curves import Stability
from heliogauge.errors import InputError
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.results.tables import read_table_csv
from tests.calibration.heliostat_folders import TARGET, write_paint

DAY = datetime.date(2026, 6, 21)


@pytest.fixture(scope="module")
def paint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of one heliostat with linear actuators."""
    folder = tmp_path_factory.mktemp("paint")
    write_paint(folder, observations=24)
    run_into(load_heliostat(folder), folder / "out", Options(thorough=False, model="4"))
    return folder / "out"


def table(out: Path, name: str = aim.AIM_FILE) -> dict[str, list[str]]:
    return read_table_csv(out / name)


def test_there_and_back(paint: Path, tmp_path: Path) -> None:
    sentences = aim.run(paint, tmp_path / "day", aim.AimOptions(DAY, 20.0))
    day = table(tmp_path / "day")
    assert day["time_utc"][0].startswith("2026-06-21T0")
    good = [row for row, status in enumerate(day["status"]) if status in ("good", "extrapolated")]
    assert len(good) > 15
    assert sentences[0].startswith(f"AA11: {len(good)} of {len(day['status'])} positions on {TARGET.name}")
    lines = ["heliostat,reading_1,reading_2,time_utc"]
    lines += [f"AA11,{day['reading_1'][row]},{day['reading_2'][row]},{day['time_utc'][row]}" for row in good]
    (tmp_path / "asked.csv").write_text("\n".join(lines) + "\n")
    aim.run(paint, tmp_path / "back", aim.AimOptions(readings=tmp_path / "asked.csv"))
    back = table(tmp_path / "back", aim.BEAM_FILE)
    for name in ("x_m", "y_m", "off_centre_mrad"):
        assert np.abs(np.array(back[name], dtype=float)).max() <= 1e-5
    assert back["sigma_beam_mrad"] == [day["sigma_beam_mrad"][row] for row in good]
    assert back["status"] == [day["status"][row] for row in good]
    # One axis of the beam's sigma, over 70 m and more.
    across = np.array(back["sigma_across_m"], dtype=float) / np.array(back["sigma_beam_mrad"], dtype=float)
    assert np.all((across > 0.07 / np.sqrt(2)) & (across < 0.12 / np.sqrt(2)))


def test_what_the_drives_cannot_do_is_said_and_has_no_readings(paint: Path, tmp_path: Path) -> None:
    content = read_heliostat(paint)
    content["design"]["limits"][1] = [30000.0, 40000.0]
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "heliostat.json").write_text(json.dumps(content))
    sentences = aim.run(tmp_path / "r", tmp_path / "out", aim.AimOptions(DAY, 30.0))
    day = table(tmp_path / "out")
    outside = [row for row, status in enumerate(day["status"]) if status == "outside the range of the drives"]
    assert len(outside) > 5
    assert f"{len(outside)} outside the range of the drives" in sentences[0]
    assert {day[name][row] for name in ("reading_1", "reading_2", "sigma_beam_mrad") for row in outside} == {""}
    # The same table on the way back: its rows stay, those without readings say so.
    aim.run(tmp_path / "r", tmp_path / "back", aim.AimOptions(readings=tmp_path / "out" / aim.AIM_FILE))
    back = table(tmp_path / "back", aim.BEAM_FILE)
    assert [row for row, status in enumerate(back["status"]) if status == "no readings"] == outside
    assert {back[name][row] for name in ("x_m", "off_centre_mrad", "sigma_beam_mrad") for row in outside} == {""}


def test_a_beam_beside_its_target_is_said(paint: Path, tmp_path: Path) -> None:
    aim.run(paint, tmp_path / "day", aim.AimOptions(DAY, 60.0))
    day = table(tmp_path / "day")
    row = day["status"].index("good")
    first, second = float(day["reading_1"][row]), float(day["reading_2"][row])
    suns = f"{day['sun_azimuth_deg'][row]},{day['sun_elevation_deg'][row]}"
    lines = [f"AA11,{first + step},{second},{suns}" for step in (0, 3000, 20000)]
    asked = tmp_path / "asked.csv"
    asked.write_text("heliostat,reading_1,reading_2,sun_azimuth_deg,sun_elevation_deg\n" + "\n".join(lines) + "\n")
    aim.run(paint, tmp_path / "back", aim.AimOptions(readings=asked))
    back = table(tmp_path / "back", aim.BEAM_FILE)
    assert back["status"][:2] == ["good", "beside the target"]
    # The sun has five digits of a degree: a third of a micrometre on the ground, 2e-4 mrad of the beam.
    assert float(back["off_centre_mrad"][0]) < 1e-3
    assert float(back["off_centre_mrad"][1]) > 10


def test_the_sigma_is_that_of_the_prediction(tmp_path: Path) -> None:
    write_paint(tmp_path, observations=24)
    one = calibrate(load_heliostat(tmp_path), Options(thorough=True, model="4")).heliostats[0]
    assert one.sky is not None
    forecast = SkyForecast(
        np.array(one.sky.azimuths_deg, float),
        np.array(one.sky.elevations_deg, float),
        one.sky.sigma_beam_rad,
        one.sky.extrapolated,
    )
    place = np.argwhere(np.isfinite(one.sky.sigma_beam_rad))[::7]
    azimuth, elevation = forecast.azimuths_deg[place[:, 1]], forecast.elevations_deg[place[:, 0]]
    sigma, beyond = forecast.at(direction_from_angles(np.deg2rad(azimuth), np.deg2rad(elevation)))
    np.testing.assert_allclose(sigma, one.sky.sigma_beam_rad[tuple(place.T)], rtol=1e-9)
    np.testing.assert_array_equal(beyond, one.sky.extrapolated[tuple(place.T)])
    between = direction_from_angles(np.deg2rad([143.0, 187.0, 218.0]), np.deg2rad([33.0, 47.0, 26.0]))
    wanted = predict_aim(one.fit, between, TARGET.center_m).sigma_beam_rad
    # Within the suns used, where an extrapolation's factor does not jump between two suns of the map.
    np.testing.assert_allclose(forecast.at(between)[0], wanted, rtol=0.25)


def test_the_map_continues_over_north_and_below_its_lowest_sun() -> None:
    sigma = np.array([[1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, np.nan]])
    forecast = SkyForecast(np.arange(0.0, 360.0, 90.0), np.array([10.0, 40.0]), sigma, sigma > 3)
    suns = direction_from_angles(np.deg2rad([315.0, 45.0, 270.0, 270.0]), np.deg2rad([10.0, 2.0, 40.0, 10.0]))
    found, beyond = forecast.at(suns)
    # Linear in variance; at the edge of what is known the largest around.
    np.testing.assert_allclose(found, np.sqrt([8.5, 2.5, 16.0, 16.0]), rtol=1e-6)
    assert beyond.tolist()[3]


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (aim.AimOptions(DAY, target="roof"), "target=roof: no such target; there are"),
        (aim.AimOptions(DAY, only="ZZ*"), r"only=ZZ\*: no heliostat of that name; there are AA11"),
        (aim.AimOptions(DAY, step_minutes=0.0), "step_minutes=0: between"),
    ],
)
def test_choices_that_cannot_be(paint: Path, tmp_path: Path, options: aim.AimOptions, wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        aim.run(paint, tmp_path / "e", options)
    assert not (tmp_path / "e").exists()


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        ("heliostat,reading_1,time_utc\nAA11,3,2026-06-21T10:00:00Z", "the columns reading_2 are missing"),
        ("heliostat,reading_1,reading_2\nAA11,3,4", "time_utc, or sun_azimuth_deg and sun_elevation_deg"),
        ("heliostat,reading_1,reading_2,time_utc\nAA11,3,x,2026-06-21T10:00:00Z", "row 1: reading_2 = 'x'"),
        ("heliostat,reading_1,reading_2,time_utc\nAA11,3,4,2026-06-21T10:00", "row 1: .* has no zone"),
        ("heliostat,reading_1,reading_2,time_utc\nAA11,3,4,", "row 1: time_utc is missing"),
        ("heliostat,reading_1,reading_2,time_utc\nBB22,3,4,2026-06-21T10:00:00Z", "heliostat 'BB22' is not among"),
    ],
)
def test_tables_that_cannot_be_meant(paint: Path, tmp_path: Path, lines: str, wanted: str) -> None:
    (tmp_path / "asked.csv").write_text(lines + "\n")
    with pytest.raises(InputError, match=wanted):
        aim.run(paint, tmp_path / "e", aim.AimOptions(readings=tmp_path / "asked.csv"))


def test_search_spiral_goes_where_it_says(paint: Path, tmp_path: Path) -> None:
    """Readings of a search, asked back, put the beam on each aim point of the spiral."""
    noon = "2026-06-21T11:30:00Z"
    aim.run(paint, tmp_path / "search", aim.AimOptions(search=1, time=noon))
    steps = table(tmp_path / "search", aim.SEARCH_FILE)
    side = min(TARGET.width_m, TARGET.height_m) / 2
    wanted = np.array([steps["right_m"], steps["up_m"]], dtype=float).T
    assert wanted[:3] / side == pytest.approx(np.array([[0, 0], [1, 0], [1, 1]]), abs=1e-9)
    assert len({tuple(one) for one in wanted.tolist()}) == 9
    lines = ["heliostat,reading_1,reading_2,time_utc"]
    lines += [f"AA11,{a},{b},{noon}" for a, b in zip(steps["reading_1"], steps["reading_2"], strict=True)]
    (tmp_path / "asked.csv").write_text("\n".join(lines) + "\n")
    aim.run(paint, tmp_path / "back", aim.AimOptions(readings=tmp_path / "asked.csv"))
    back = table(tmp_path / "back", aim.BEAM_FILE)
    assert pytest.approx(wanted, abs=2e-5) == np.array([back["x_m"], back["y_m"]], dtype=float).T


def test_searches_that_cannot_be_meant(paint: Path, tmp_path: Path) -> None:
    for options, said in (
        (aim.AimOptions(search=1), "belong together"),
        (aim.AimOptions(search=1, time="2026-06-21T23:30:00Z"), "below the horizon"),
        (aim.AimOptions(search=1, time="2026-06-21T11:30:00Z", readings=tmp_path / "x.csv"), "one of both"),
    ):
        with pytest.raises(InputError, match=said):
            aim.run(paint, tmp_path / "out", options)


def test_curves_of_a_calibrated_heliostat(paint: Path, tmp_path: Path) -> None:
    """What the calibration found comes out of its model; a parameter alone is what the whole has of it."""
    winter = datetime.date(2026, 12, 21)
    options = curves.CurvesOptions(dates=(DAY, winter), draws=3, change_rad=2e-3)
    sentences = curves.run(paint, tmp_path / "curves", options)
    assert sentences[0].startswith("AA11: beam error as before the calibration")
    daily = table(tmp_path / "curves", curves.DAILY_FILE)
    assert set(daily["date"]) == {str(DAY), str(winter)}
    free = {name for name, of in zip(daily["cause"], daily["of"], strict=True) if of == "one"}
    assert len(free) == 4
    sizes = [float(one) for one, of in zip(daily["rms_mrad"], daily["of"], strict=True) if of == "one"]
    # A turn of the normal by 2 mrad turns the beam by 4 at most.
    assert 0 < min(sizes) <= max(sizes) <= 4.001
    points = table(tmp_path / "curves", curves.CURVES_FILE)
    rows = [
        row for row, cause in enumerate(points["cause"]) if cause == daily["cause"][0] and points["right_mrad"][row]
    ]
    first = [row for row in rows if points["time_utc"][row].startswith("2026-06-21")]
    squares = sum(float(points[name][row]) ** 2 for row in first for name in ("right_mrad", "up_mrad"))
    assert np.sqrt(squares / len(first)) == pytest.approx(float(daily["rms_mrad"][0]), rel=1e-3)
    stable = table(tmp_path / "curves", curves.STABILITY_FILE)
    assert stable["estimated_from"] == [str(DAY)] * 2
    assert float(stable["over_first_day_ratio"][0]) == 1.0


def test_a_day_without_a_beam_is_unknown(paint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A day on which the heliostat cannot serve the target has no RMS; of one draw nobody knows the spread."""
    monkeypatch.setattr(curves, "stability", lambda *_, **__: Stability(np.array([[1e-3, np.nan]]), 0))
    options = curves.CurvesOptions(dates=(DAY, datetime.date(2026, 12, 21)), draws=1)
    (sentence,) = curves.run(paint, tmp_path / "curves", options)
    assert "1.00 mrad on that day, unknown mrad on the other" in sentence
    assert sentence.endswith("2026-12-21")
    stable = table(tmp_path / "curves", curves.STABILITY_FILE)
    assert stable["rms_mrad"] == ["1.0", ""]
    assert stable["over_first_day_ratio"] == ["1.0", ""]
    assert stable["spread_mrad"] == ["", ""]
