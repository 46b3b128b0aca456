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
    assert result.doubts == (Doubt("module_doubtful", f"{second}: a doubt", {"modules_count": 1}, Severity.SERIOUS),)
    assert "theta_r 3.00 mrad RMS, theta_ra 2.50 mrad RMS" in result.headline()
    assert len(result.input_sha256) == 2


def test_other_results_and_doubled_ones_are_refused(tmp_path):
    first, other = result_of(tmp_path / "a"), result_of(tmp_path / "b", kind="deflectometry")
    with pytest.raises(InputError, match='kind "deflectometry"'):
        run([first, other])
    with pytest.raises(InputError, match="given twice"):
        run([first, tmp_path / "b" / ".." / "a"])
    field = run([first])
    (tmp_path / "field").mkdir()
    field.write(tmp_path / "field")
    with pytest.raises(InputError, match=r"an overview itself; give the results of its modules: .*a"):
        run([tmp_path / "field"])


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


PANELS = (
    "panel,centre_x_m,centre_y_m,mean_theta_ra_rad,sigma_mean_theta_ra_rad,mount_move_m,sigma_mount_move_m,gain_ratio,"
    "sigma_gain_ratio,gain_is_sure\n"
)


def module(folder, name, gains, count, doubts=()):
    """Return a result whose panels gain by a turn of 2 mrad each."""
    own = {"intercept_gain_panels_turned_ratio": sum(gains[:count]), "panels_to_turn_count": count}
    made = result_of(
        folder / name, doubts=doubts, sigma_intercept_gain_panels_turned_ratio=4e-4, intercept_ratio=0.97, **own
    )
    lines = [f"{k + 1},{k},0.5,-2e-3,1e-4,1e-3,5e-5,{gain},1e-4,{int(k < count)}" for k, gain in enumerate(gains)]
    (made / "panels.csv").write_text(PANELS + "\n".join(lines) + "\n")
    return made


def test_the_work_list_has_the_panels_of_all_modules_by_their_gains(tmp_path):
    from observer.report import overview as report

    modules = [
        module(tmp_path, "a", [0.002, 0.009, 0.0], 2),
        module(tmp_path, "b", [0.0, 0.0], 0),
        module(tmp_path, "c", [0.004], 1),
    ]
    run(modules, base=tmp_path, failed={"d": "no photos"}).write(tmp_path)
    table = read_table_csv(tmp_path / "panels_to_turn.csv", ())
    assert list(zip(table["result"], table["panel"], strict=True)) == [("a", "2"), ("c", "1"), ("a", "1")]
    # The panel's normal is turned to -x: it has to go to +x.
    assert {float(one) for one in table["turn_rad"]} == {2e-3}
    results = report.open_overview(tmp_path)
    first = report.head(results).text
    assert "Gain by turning 3 panels of 2 modules" in first
    # Mean of 0.011, 0 and 0.004; sigma 4e-4 over the root of three.
    assert "0.500 \u00b1 0.023 % of the light" in first
    assert "most by a panel 2 by 2.00 \u00b1 0.10 mrad towards +x" in first
    chart = report.field(results)
    assert [(one.name, list(one.names)) for one in chart.series] == [
        ("gains 1 % and more", ["a"]),
        ("gains 0.1 to 1 %", ["c"]),
        ("nothing sure to gain", ["b"]),
        ("not measured", ["d"]),
    ]
    listed = report.work_list(results)._repr_html_()
    assert [f"{one} %" for one in (60, 87, 100) if f"{one} %" in listed] == ["60 %", "87 %", "100 %"]
    # What gains nothing that is printed waits until it is asked for.
    module(tmp_path, "e", [1e-5], 1)
    run([*modules, tmp_path / "e"], base=tmp_path, failed={"d": "no photos"}).write(tmp_path)
    longer = report.work_list(report.open_overview(tmp_path))
    assert (len(longer.columns[0].texts), longer.most_rows) == (4, 3)
    assert next(iter(longer.columns[5].texts)) == "0.900 \u00b1 0.010"
    order = list(report.modules(results).columns[0].texts)
    assert order == ["a", "c", "b", "d"]


def test_one_cause_in_many_modules_is_one_warning(tmp_path):
    doubt, note = Doubt("blurred", "blurred photos"), Doubt("fine", "a note", severity=Severity.NOTE)
    modules = [module(tmp_path, f"m{k}", [0.0], 0, (doubt, note)) for k in range(12)]
    other = module(tmp_path, "n", [0.0], 0, (Doubt("odd", "an odd one", severity=Severity.SERIOUS),))
    result = run([*modules, other], base=tmp_path)
    assert [(str(one), one.severity) for one in result.doubts] == [
        ("in 12 of 13 modules blurred photos (numbers of m0; the others: m1, m2, m3, m4, m5 ...)", Severity.DOUBT),
        ("n: an odd one", Severity.SERIOUS),
    ]
