"""A field at two dates: the panel that turned is named by its module, and chance counts over the whole field."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.results.arrays import LabelledArray, write_arrays
from heliogauge.results.folder import Summary, read_summary, write_summary, write_table_csv
from heliogauge.results.tables import read_table_csv
from observer.cli import app
from observer.files import ANGLES, COLLECTOR, OVERVIEW_TABLE, write_collector
from observer.product.changes import PanelChanges, decide_together
from observer.studies.compare_fields import run
from observer.trough.collector import Collector

SIGMA_RAD = 2e-4


def _two_by_four() -> Collector:
    return Collector(5.0, 3.0, 1.49, 0.07, None, np.array([-2.5, -1.25, 0.0, 1.25, 2.5]), np.array([-1.5, 0.0, 1.5]))


def _date(folder: Path, turns_rad: Mapping[str, dict[int, float]], seed: int, doubts: tuple[Doubt, ...] = ()) -> Path:
    """Write what a flight over modules gives: panels turned by their number, from 1, with an error of each panel."""
    rng, collector = np.random.default_rng(seed), _two_by_four()
    folder.mkdir()
    for name, turned in turns_rad.items():
        _write_module(folder / name, collector, turned, rng, doubts)
    names = list(turns_rad)
    columns = {"result": names, "name": names, "place_x_m": [7.0 * k for k in range(len(names))]}
    write_table_csv(folder / OVERVIEW_TABLE, columns | {"place_y_m": [0.0] * len(names), "failed": [""] * len(names)})
    return folder


def _write_module(
    folder: Path, collector: Collector, turned: dict[int, float], rng: np.random.Generator, doubts: tuple[Doubt, ...]
) -> None:
    folder.mkdir()
    x = np.linspace(-0.49, 0.49, 40) * collector.aperture_width_m
    y = np.linspace(-0.49, 0.49, 30) * collector.length_m
    panel = collector.panel_index(*np.meshgrid(x, y))
    errors = SIGMA_RAD * rng.standard_normal(panel.max() + 1)
    for number, turn in turned.items():
        errors[number - 1] += turn
    angle = np.where(panel >= 0, errors[panel], np.nan)
    axes = [LabelledArray("y", ("y",), y, "m", "along"), LabelledArray("x", ("x",), x, "m", "across")]
    maps = [LabelledArray(f"theta_{one}", ("y", "x"), angle.astype(np.float32), "rad", one) for one in ("r", "ra")]
    write_arrays(folder / ANGLES, [*axes, *maps], {})
    count = panel.max() + 1
    sigmas = {f"sigma_mean_theta_{one}_rad": [SIGMA_RAD] * count for one in ("r", "ra")}
    write_table_csv(folder / "panels.csv", {"panel": list(range(1, count + 1)), **sigmas})
    write_collector(folder / COLLECTOR, collector)
    kept = 0.98 - 5.0 * sum(abs(one) for one in turned.values())
    numbers = {"intercept_ratio": kept + 1e-3 * rng.standard_normal(), "sigma_intercept_ratio": 1e-3}
    summary = Summary("observer", folder.name, numbers, {}, doubts, {}, {})
    write_summary(folder / "summary.json", summary)


def test_the_panel_that_turned_is_named_by_the_command(tmp_path: Path) -> None:
    modules = {f"m{k}": dict[int, float]() for k in range(6)}
    spring = _date(tmp_path / "spring", modules, 1)
    serious = (Doubt("a_doubt", "a doubt", severity=Severity.SERIOUS),)
    autumn = _date(tmp_path / "autumn", modules | {"m4": {3: 5e-3}, "m9": {}}, 2, serious)
    answer = CliRunner().invoke(app, ["compare", str(spring), str(autumn), "-o", str(tmp_path / "out")])
    assert answer.exit_code == 0, answer.output
    assert "1 of 48 panels surely turned" in answer.output
    assert "m4: panel 3" in answer.output
    panels = read_table_csv(tmp_path / "out" / "changed_panels.csv", ("of", "panel", "is_sure"))
    sure = [k for k, one in enumerate(panels["is_sure"]) if one == "1"]
    assert [(panels["of"][k], panels["panel"][k]) for k in sure] == [("m4", "3")]
    assert float(panels["theta_ra_change_rad"][sure[0]]) == pytest.approx(5e-3, abs=4 * np.sqrt(2) * SIGMA_RAD)
    changed = read_table_csv(tmp_path / "out" / "changed_numbers.csv", ("of", "is_sure"))
    assert [of for of, one in zip(changed["of"], changed["is_sure"], strict=True) if one == "1"] == ["m4"]
    found = read_summary(tmp_path / "out")
    assert {one.code for one in found.doubts} == {"module_at_one_date", "used_results_serious"}
    change, sigma = (found.numbers[f"{k}intercept_change_mean_ratio"] for k in ("", "sigma_"))
    # What flights have in common does not average out over modules.
    assert sigma == pytest.approx(np.sqrt(2.0) * 1e-3)
    assert change == pytest.approx(-0.025 / 6, abs=4 * sigma)
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "in 1 of 6 modules" in report


def test_chance_counts_over_the_whole_field() -> None:
    """Each module by itself would name a panel of a steady field of 100 modules in most comparisons."""
    rng, count, runs, modules = np.random.default_rng(5), 8, 200, 100
    sigma, known = np.full(count, 1e-4), np.ones(count)
    together = apart = 0
    for _ in range(runs):
        parts = [
            PanelChanges(np.arange(count), change, sigma, change, sigma, known, np.zeros(count, dtype=np.bool_))
            for change in 1e-4 * rng.standard_normal((modules, count))
        ]
        together += any(one.is_sure.any() for one in decide_together(parts))
        apart += any(decide_together([one])[0].is_sure.any() for one in parts)
    # Both angles are counted as apart; here they are alike, which makes it half as often.
    assert together <= 0.01 * runs + 3.0
    assert apart > 0.2 * runs


def test_what_is_no_pair_of_fields_is_refused(tmp_path: Path) -> None:
    first = _date(tmp_path / "a", {"m1": {}}, 1)
    other = _date(tmp_path / "b", {"m2": {}}, 2)
    with pytest.raises(InputError, match="no module was measured at both dates; their names are m1 and m2"):
        run([first, other])
    (other / "m2" / "summary.json").unlink()
    with pytest.raises(InputError, match="none of its 1 modules has results below it"):
        run([first, other])
    with pytest.raises(InputError, match="same result"):
        run([first, tmp_path / "b" / ".." / "a"])
    with pytest.raises(InputError, match="those of two dates"):
        run([first])


def test_overviews_of_results_from_elsewhere(tmp_path: Path) -> None:
    folders = [_date(tmp_path / name, {"m1": {}, "m2": {turn: 5e-3}}, turn) for name, turn in (("a", 1), ("b", 2))]
    overviews = []
    for folder in folders:
        overviews.append(tmp_path / f"overview-{folder.name}")
        overviews[-1].mkdir()
        table = read_table_csv(folder / OVERVIEW_TABLE, ("result",))
        paths = [str(folder / name) for name in table["result"]]
        write_table_csv(overviews[-1] / OVERVIEW_TABLE, {"result": paths, "name": table["name"]})
    found = run(overviews)
    assert [one.label for one in found.modules] == ["m1", "m2"]
    assert [one.panels.panel[one.panels.is_sure].tolist() for one in found.modules if one.panels] == [[], [1, 2]]


def test_modules_of_the_same_name_in_other_rows_are_not_paired(tmp_path: Path) -> None:
    """Names count from the folder that all results lie in: row1/m1 is not row2/m1."""
    overviews = []
    for date, rows in (("a", ("row1", "row2")), ("b", ("row2",))):
        (tmp_path / date).mkdir()
        paths = []
        for row in ("row1", "row2"):
            folder = _date(tmp_path / date / row, {"m1": {1: 5e-3 * (date == "b")}} if row in rows else {}, 1)
            paths.append(str(folder / "m1"))
        overviews.append(tmp_path / f"overview-{date}")
        overviews[-1].mkdir()
        failed = ["" if Path(path).parent.name in rows else "no targets" for path in paths]
        write_table_csv(overviews[-1] / OVERVIEW_TABLE, {"result": paths, "name": paths, "failed": failed})
    found = run(overviews)
    assert [one.label for one in found.modules] == ["row2/m1"]
    assert [one.code for one in found.doubts] == ["module_at_one_date"]


def test_one_module_of_another_design_is_left_out_and_one_that_moved_is_doubted(tmp_path: Path) -> None:
    folders = [_date(tmp_path / name, {"m1": {}, "m2": {}, "m3": {}}, k) for k, name in enumerate("ab")]
    design = _two_by_four()
    write_collector(folders[1] / "m2" / COLLECTOR, replace(design, focal_length_m=1.4901))
    table = read_table_csv(folders[1] / OVERVIEW_TABLE, ("result",))
    table["place_x_m"][2] = "100.0"
    write_table_csv(folders[1] / OVERVIEW_TABLE, table)
    found = run(folders)
    assert [one.label for one in found.modules] == ["m1", "m3"]
    assert {one.code: one.text[:3] for one in found.doubts} == {"module_not_compared": "m2:", "module_elsewhere": "m3:"}
