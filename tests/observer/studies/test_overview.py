"""One table for several modules."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.results.folder import Summary, write_summary
from heliogauge.results.tables import read_table_csv
from observer.files import OVERVIEW_MAPS, ModuleMap, write_maps
from observer.report.figures_modules import maps_sheet, module_angle
from observer.studies.overview import run


def result_of(folder, kind="observer", doubts=(), **numbers):
    folder.mkdir()
    write_summary(
        folder / "summary.json",
        Summary(
            kind=kind,
            name=folder.name.upper(),
            numbers=numbers,
            texts={},
            doubts=doubts,
            durations_s={},
            input_sha256={},
            not_determined={key: "unseen" for key, value in numbers.items() if value is None},
        ),
    )
    return folder


def test_a_row_for_each_module(tmp_path):
    first = result_of(tmp_path / "a1", rms_theta_r_rad=3e-3, rms_theta_ra_rad=2.5e-3)
    doubt = Doubt("a_doubt", "a doubt", severity=Severity.SERIOUS)
    second = result_of(tmp_path / "a2", doubts=(doubt,), rms_theta_r_rad=None, edges_used_count=12)
    result = run([first, second])
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    table = read_table_csv(tmp_path / "out" / "overview.csv", ("result", "name"))
    assert table["name"] == ["A1", "A2"]
    assert [float(table["rms_theta_r_rad"][0]), table["rms_theta_r_rad"][1]] == [3e-3, ""]
    assert table["edges_used_count"] == ["", "12"]
    assert table["warnings"] == ["0", "1"]
    assert result.doubts == (Doubt("module_doubtful", f"{second}: a doubt", {"doubts_count": 1}, Severity.SERIOUS),)
    assert "theta_r 3.00 mrad RMS, theta_ra 2.50 mrad RMS" in result.headline()
    assert len(result.input_sha256) == 2


def test_other_results_and_doubled_ones_are_refused(tmp_path):
    first, other = result_of(tmp_path / "a"), result_of(tmp_path / "b", kind="deflectometry")
    with pytest.raises(InputError, match='kind "deflectometry"'):
        run([first, other])
    with pytest.raises(InputError, match="given twice"):
        run([first, tmp_path / "b" / ".." / "a"])


def test_the_report_shows_every_module_and_links_to_those_below_it(tmp_path):
    from observer.report import overview as report

    folders = [
        result_of(tmp_path / name, rms_theta_r_rad=3e-3, sigma_rms_theta_r_rad=1e-4, intercept_ratio=0.99)
        for name in ("one", "two")
    ]
    run(folders, base=tmp_path, failed={"three": "no <targets>"}).write(tmp_path)
    x, y = np.linspace(-2.5, 2.5, 26), np.linspace(-1.5, 1.5, 16)
    theta = np.where(x > 0, 2e-3, -1e-3) * np.ones((16, 1))
    theta[3] = np.nan
    write_maps(tmp_path / OVERVIEW_MAPS, [ModuleMap(name, x, y, theta, theta + 1e-3) for name in ("one", "two")])
    results = report.open_overview(tmp_path)
    np.testing.assert_allclose(results.maps[1].theta_r_rad, theta + 1e-3, atol=1e-9)
    table = report.modules(results)._repr_html_()
    assert '<a href="two/report.html">two</a>' in table
    assert "3.00 \u00b1 0.10 mrad" in table
    assert "no &lt;targets&gt;" in table
    assert report.maps(results).text.count("<img") == 1
    first = report.head(results).text
    assert first.count("<img") == 1
    assert "1 of 3 modules not measured" in first
    assert "median of the modules; 3 mrad to 3 mrad" in first
    # theta_r and the intercept factor of the modules that were measured.
    assert report.numbers(results).text.count("<img") == 2
    layers = report.head(results).picture.layers
    assert [layer.key for layer in layers] == ["one", "two"]
    np.testing.assert_allclose(np.nanmean(np.abs(layers[0].values)), 1.5e-3, rtol=1e-6)
    # Without maps on one grid the numbers stand there.
    chart = report.first_view(replace(results, maps=[]))
    np.testing.assert_allclose(chart.series[0].y, [3.0, 3.0])
    np.testing.assert_allclose(chart.series[0].sigma, [0.1, 0.1])
    assert list(chart.series[0].labels) == ["one", "two"]
    # Half of the aperture at +1.5, half at -1.5 mrad without the mean.
    shown = [module_angle(one, "theta_r") for one in results.maps]
    assert "one: 1.50 mrad RMS" in maps_sheet(shown, "").svg()
    assert "overview of 3 modules" in first


def test_loops_have_numbers_of_their_own(tmp_path):
    from observer.report import overview as report

    numbers = {"intercept_gain_panels_turned_ratio": 0.01, "panels_to_turn_count": 2}
    (tmp_path / "east").mkdir()
    (tmp_path / "west").mkdir()
    folders = [
        result_of(tmp_path / loop / f"m{k}", rms_theta_r_rad=slope, intercept_ratio=kept, **numbers)
        for loop, k, slope, kept in (("east", 1, 3e-3, 0.95), ("east", 2, 4e-3, 0.93), ("west", 1, 1e-3, 0.99))
    ]
    result = run(folders)
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    table = read_table_csv(tmp_path / "out" / "loops.csv", ())
    assert table["loop"] == ["east", "west", "all"]
    assert table["modules_count"] == ["2", "1", "3"]
    assert table["panels_to_turn_count"] == ["4", "2", "6"]
    np.testing.assert_allclose(
        [float(one) for one in table["rms_theta_r_rad"]], [12.5e-6**0.5, 1e-3, (26e-6 / 3) ** 0.5]
    )
    np.testing.assert_allclose([float(one) for one in table["intercept_ratio"]], [0.94, 0.99, 2.87 / 3])
    np.testing.assert_allclose([float(one) for one in table["lowest_intercept_ratio"]], [0.93, 0.99, 0.93])
    assert read_table_csv(tmp_path / "out" / "overview.csv", ())["loop"] == ["east", "east", "west"]
    page = report.loops(report.open_overview(tmp_path / "out")).text
    assert "east" in page
    assert ">0.94<" in page
    # Results of one folder are of no loop.
    assert run(folders[:2]).loops == {}
