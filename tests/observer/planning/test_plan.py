"""Planning a pass: stations, sigmas to be expected, what is missing and where to fly."""

from pathlib import Path

import numpy as np
import pytest

from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.results.folder import read_summary, read_table_csv
from heliogauge.results.slope_map_file import read_slope_map
from observer.planning.keys import load_observer_plan
from observer.planning.plan import planned_targets, run
from observer.planning.planned_flight import Pass, advice
from observer.report import plan as report
from tests.observer.simulated_trough import short_trough

TEMPLATE = """
kind = "observer-plan"
name = "short trough"
[collector]
aperture_width_m = 5.0
length_m = 3.16
focal_length_m = 1.49
absorber_diameter_mm = 70.0
panel_edges_x_m = [-2.5, -1.34, 0.0, 1.34, 2.5]
panel_edges_y_m = [-1.58, 0.0, 1.58]
panel_gap_mm = 10.0
[camera]
width_px = 480
height_px = 640
focal_px = 1030.0
[targets]
sigma_px = 0.05
[[flight]]
height_m = 12.0
reach_m = {reach}
photos = 24
{more}
[evaluation]
row_step_mm = 400.0
column_step_mm = 60.0
longitudinal_slope_mrad = 0.5
"""


def planned(folder: Path, *, reach: float = 2.9, more: str = "", sigma_mm: float = 1.0) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "measurement.toml").write_text(TEMPLATE.format(reach=reach, more=more))
    lines = ["target,x_m,y_m,z_m,sigma_x_mm,sigma_y_mm,sigma_z_mm"]
    for k in range(12):
        x, y = (-2.71, 2.71)[k // 6], -1.4 + 2.8 * (k % 6) / 5
        lines.append(f"{k + 1},{x},{y:.3f},1.049,{sigma_mm},{sigma_mm},{sigma_mm}")
    (folder / "targets.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_a_plan_is_written_whole(tmp_path: Path) -> None:
    more = "[monte_carlo]\nruns = 2\nrow_step_mm = 400.0"
    result = run(load_observer_plan(planned(tmp_path / "plan", more=more)))
    out = tmp_path / "out"
    out.mkdir()
    result.write(out)
    summary = read_summary(out / "summary.json")
    numbers = summary.numbers
    assert summary.kind == "observer-plan"
    assert numbers["photos_count"] == 24
    assert 2e-5 < float(numbers["sigma_slope_x_median_rad"] or 0) < 1e-3
    assert 0.5 < float(numbers["measured_share"] or 0) < 0.95
    assert numbers["monte_carlo_runs_count"] == 2
    stations = read_table_csv(out / "stations.csv")
    np.testing.assert_allclose(np.array(stations["x_m"], dtype=float), np.linspace(-2.9, 2.9, 24), atol=1e-9)
    assert set(stations["targets_count"]) == {"12"}
    slope_map = read_slope_map(out / "slope_map.nc")
    assert slope_map.measured_share == pytest.approx(float(numbers["measured_share"] or 0))
    assert len(read_table_csv(out / "monte_carlo.csv")["x_m"]) > 200
    assert "24 photos" in result.headline()
    # Two runs do not settle anything, and the ends of the mirror cannot be seen from the middle.
    assert "monte_carlo_not_settled" in [one.code for one in result.doubts]
    assert "plan_beyond_tube" in [one.code for one in result.doubts]
    results = report.open_plan(out)
    first = report.head(results).text
    assert f"{100 * (1 - slope_map.measured_share):.1f} % of the mirror would not be measured" in first
    assert "95 % of the points are below" in first
    assert "beyond the tube&#x27;s ends" in report.doubts(results).text
    parts = (report.head, report.missing, report.flight, report.absorber, report.scene)
    assert [part(results)._repr_html_().count("<img") for part in parts] == [1, 1, 2, 1, 2]
    assert report.repeated(results).text.count("<img") == 2
    side = {one.name: one for one in report.flight_view(results, "x").series}
    np.testing.assert_allclose(side["cameras"].x[[0, -1]], [-2.9, 2.9])
    # Every line of sight begins at its camera and ends at a gap.
    np.testing.assert_allclose(side["directions of view"].x[::3], side["cameras"].x)
    assert np.isnan(side["directions of view"].y[2::3]).all()
    (out / "monte_carlo.csv").unlink()
    assert report.repeated(results).text == ""


def test_a_pass_that_is_too_short_is_told_how_far_to_fly(tmp_path: Path) -> None:
    result = run(load_observer_plan(planned(tmp_path / "plan", reach=1.5)))
    assert result.missing[SampleFlag.NOT_COVERED] > 0.2
    assert any(one.code == "plan_pass_too_short" and "fly from -2." in one.text for one in result.doubts)


def test_targets_decide_what_the_cameras_are_worth(tmp_path: Path) -> None:
    found = []
    for sigma_mm in (1.0, 5.0):
        result = run(load_observer_plan(planned(tmp_path / f"plan{sigma_mm}", sigma_mm=sigma_mm)))
        found.append(result.summarise().numbers)
    # Less than five times: the reflection tells cameras too.
    assert float(found[1]["sigma_camera_position_rms_m"] or 0) > 1.5 * float(
        found[0]["sigma_camera_position_rms_m"] or 0
    )
    assert float(found[1]["sigma_slope_x_median_rad"] or 0) > float(found[0]["sigma_slope_x_median_rad"] or 0)


def test_an_earlier_result_is_looked_at_again(tmp_path: Path) -> None:
    first = run(load_observer_plan(planned(tmp_path / "plan")))
    out = tmp_path / "out"
    out.mkdir()
    first.write(out)
    again = run(load_observer_plan(planned(tmp_path / "again", more='[mirror]\nlike = "../out"')))
    truth = read_slope_map(out / "slope_map.nc").slope_error_x
    both = np.isfinite(truth) & np.isfinite(again.simulated.slope_map.slope_error_x)
    difference = again.simulated.slope_map.slope_error_x[both] - truth[both]
    assert np.std(difference) < 0.2 * np.std(truth[both])


def test_targets_may_be_planned_along_the_rims_without_a_list(tmp_path: Path) -> None:
    folder = planned(tmp_path / "plan")
    text = (folder / "measurement.toml").read_text()
    (folder / "targets.csv").unlink()
    toml = text.replace("[targets]\n", "[targets]\nrim_count = 8\nsigma_mm = 2.0\n").replace('file = "targets.csv"', "")
    (folder / "measurement.toml").write_text(toml)
    model = load_observer_plan(folder).model
    coordinates, names, points = planned_targets(model, folder)
    assert len(coordinates) == 24
    assert {one.sigma_mm for one in coordinates} == {2.0}
    assert names == tuple("12345678")
    np.testing.assert_allclose(np.abs(points[:, 0]), 2.6)
    np.testing.assert_allclose(points[:, 2], 25 / (16 * 1.49))
    for change, message in (("rim_count = 7", "even number"), ('rim_count = 8\nfile = "t.csv"', "one of both")):
        (folder / "measurement.toml").write_text(toml.replace("rim_count = 8", change))
        with pytest.raises(InputError, match=message):
            load_observer_plan(folder)


def test_what_cannot_be_planned_is_refused(tmp_path: Path) -> None:
    folder = planned(tmp_path / "plan")
    text = (folder / "measurement.toml").read_text()
    (folder / "measurement.toml").write_text(text.replace("focal_px = 1030.0\n", ""))
    with pytest.raises(InputError, match="a plan has no photos to take them from"):
        load_observer_plan(folder)
    (folder / "measurement.toml").write_text(text.replace("focal_px = 1030.0", "focal_px = 9000.0"))
    with pytest.raises(EstimationError, match="photos see 4 of 12 targets"):
        run(load_observer_plan(folder))
    (folder / "measurement.toml").write_text(text)
    table = (folder / "targets.csv").read_text()
    (folder / "targets.csv").write_text(table.replace("1,-2.71,-1.400,1.049,1.0,1.0,1.0", "1,-2.71,-1.400,,,,"))
    with pytest.raises(InputError, match="line 2: target 1 needs x_m, y_m and z_m"):
        run(load_observer_plan(folder))
    (folder / "targets.csv").unlink()
    with pytest.raises(InputError, match=r"there is no file targets\.csv"):
        load_observer_plan(folder)


def test_advice_says_nothing_of_a_pass_that_shows_all() -> None:
    collector = short_trough()
    assert list(advice(collector, (Pass(12.0, 3.2, 50),), {}, 1e-3)) == []
    found = list(advice(collector, (Pass(12.0, 2.0, 50),), {SampleFlag.BEYOND_TUBE: 0.1}, 1e-3))
    assert "fly from -2.7" in found[0].text
    assert "y = -1.58 and 1.58 m" in found[1].text
    with pytest.raises(InputError, match="1 photos"):
        Pass(12.0, 3.0, 1)


@pytest.mark.slow
def test_other_flights_are_compared(tmp_path: Path) -> None:
    folder = planned(tmp_path / "plan")
    toml = folder / "measurement.toml"
    toml.write_text(toml.read_text().replace('name = "short trough"', 'name = "short trough"\nalternatives = true'))
    result = run(load_observer_plan(folder))
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    columns = read_table_csv(tmp_path / "out" / "alternatives.csv")
    assert columns["photos"] == ["24", "12", "48", "24", "34"]
    number = {key: np.array(cells, float) for key, cells in columns.items() if key not in ("flight", "photos")}
    usual, half, twice, apart, aside = range(5)
    share, own = number["measured_share"], number["sigma_random_slope_x_median_rad"]
    # The first row is the plan itself: a table in coarser rows measured less of the mirror, with twice the photos too.
    for key in set(number) & set(result.summarise().numbers):
        assert number[key][usual] == pytest.approx(result.summarise().numbers[key])
    slope_map, stated = result.simulated.slope_map, number["sigma_theta_r_median_rad"][usual]
    sigma = slope_map.sigma_slope()[0] / (1 + slope_map.slope_x**2)
    assert stated == pytest.approx(float(np.median(sigma[slope_map.valid])))
    # Frame, cameras and tube tilt the whole map alike: that part of sigma goes.
    assert (number["sigma_theta_r_without_tilt_median_rad"] < number["sigma_theta_r_median_rad"]).all()
    assert share[half] < share[usual] <= share[twice]
    assert own[twice] < own[usual] < own[half]
    # Photos of one place say little of how high the tube is; from the side they see it against the targets.
    assert number["sigma_absorber_z_rms_m"][aside] < number["sigma_absorber_z_rms_m"][usual]
    assert columns["flight"][apart] == "the same photos in two passes 1.6 m apart"
    page = report.alternatives(report.open_plan(tmp_path / "out")).text
    assert "twice as many photos" in page
