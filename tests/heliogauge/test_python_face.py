"""``import heliogauge as hg``: what it offers, what it costs, and that a result is the same in memory and on disk."""

import subprocess
import sys
from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

import heliogauge as hg
from heliogauge.errors import InputError
from heliogauge.instruments import Instrument, instruments, resolve
from heliogauge.measurement.templates import write_template
from heliogauge.results.opened import Tables
from heliogauge.results.slope_map_file import read_slope_map, write_slope_map
from heliogauge.results.tables import write_table_csv
from observer.files import write_angles
from observer.product.slope_map import AngleMaps


@pytest.fixture(scope="module")
def facet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hg.synth("deflectometry", str(tmp_path_factory.mktemp("face") / "facet"), seed=3)


@pytest.fixture(scope="module")
def result(facet: Path) -> hg.Result:
    return hg.measure(str(facet), remove="tilt")


def test_importing_it_imports_no_library() -> None:
    program = "import sys; before = set(sys.modules); import heliogauge; print(*sorted(set(sys.modules) - before))"
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "cv2", "pydantic", "typer", "h5py", "xarray", "pandas", "importlib.metadata"}
    assert heavy.isdisjoint(answer.stdout.split())


def test_a_result_on_disk_is_the_same(result: hg.Result, tmp_path: Path) -> None:
    again = hg.open(str(result.save(str(tmp_path / "out"))))
    assert again.summary == result.summary
    assert again.doubts == result.doubts
    assert again.slope_map.identical(result.slope_map)
    assert list(again.tables) == list(result.tables)


def test_the_numbers_are_those_of_the_map(result: hg.Result) -> None:
    """SDx again from the map that users get, by another route: angles of the normal in the plane x-z."""
    assert result.kind == "deflectometry"
    maps = result.slope_map
    angles = np.arctan(maps["slope_x"]) - np.arctan(maps["design_slope_x"])
    assert float(np.sqrt((angles**2).mean())) == pytest.approx(result.summary["sdx_rad"], rel=0.02)
    assert "tilt" in maps.attrs["removed"]


def test_its_text_is_short(result: hg.Result) -> None:
    lines = repr(result).splitlines()
    assert lines[0].startswith("<deflectometry result of ")
    assert "+-" in lines[1]
    assert len(lines) <= 9


def test_tables_are_data_frames(result: hg.Result) -> None:
    assert result.tables["outline"].shape[0] >= 4
    with pytest.raises(InputError, match="'points' is not among the results; there are: outline"):
        result.tables["points"]


def test_tables_have_texts_as_they_were(tmp_path: Path) -> None:
    columns = {"id": ["=1+1", "-A7", "'b'"], "-c": ["x", "", "-2"], "x_m": [1.0, -2.0, float("nan")]}
    write_table_csv(tmp_path / "points.csv", columns)
    table = Tables(tmp_path)["points"]
    assert list(table.columns) == list(columns)
    assert list(table["id"]) == columns["id"]
    assert list(table["-c"].fillna("")) == columns["-c"]
    assert table["x_m"].dtype == float


def test_a_table_that_is_not_there(result: hg.Result) -> None:
    assert "no_such" not in result.tables
    assert result.tables.get("no_such") is None


def test_a_measurement_is_no_result(facet: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a measurement, not results"):
        hg.open(facet)
    with pytest.raises(InputError, match="no such folder"):
        hg.open(tmp_path / "absent")


def test_the_result_of_a_stage_prints_no_arrays(facet: Path) -> None:
    from deflectometry import run

    text = repr(run(hg.load(facet)))
    assert text.startswith("<deflectometry result of")
    assert len(text) < 2000


def test_results_appear_where_they_are_asked_for(facet: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert hg.measure(facet, out, grid_step_mm=20).folder == out
    with pytest.raises(InputError, match="already"):
        hg.measure(facet, out)
    assert (out / "summary.json").is_file()


def test_a_temporary_result_goes_away_with_its_view(facet: Path) -> None:
    kept = hg.measure(facet, grid_step_mm=20)
    folder = kept.folder
    assert folder.is_dir()
    del kept
    assert not folder.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"remov": "tilt"}, "'remov' is not one of the kind 'deflectometry'; did you mean remove?"),
        ({"remove": "tiltt"}, "remove = 'tiltt'"),
        ({"grid_step_mm": "wide"}, "grid_step_mm = 'wide'"),
    ],
)
def test_options_that_are_none(facet: Path, options: dict[str, str], words: str) -> None:
    with pytest.raises(InputError) as caught:
        hg.measure(facet, **options)
    assert words in str(caught.value)


def test_load_reads_any_kind(tmp_path: Path) -> None:
    for kind in ("photogrammetry-plan", "observer-plan"):
        write_template(kind, tmp_path / kind)
        (tmp_path / kind / "targets.csv").touch()
        assert hg.load(str(tmp_path / kind)).model.kind == kind


def test_a_plan_is_measured_like_all_others(tmp_path: Path) -> None:
    write_template("photogrammetry-plan", tmp_path)
    result = hg.measure(tmp_path)
    assert result.kind == "photogrammetry-plan"
    assert len(result.tables["stations"]) >= 4
    with pytest.raises(InputError, match=r"'photogrammetry-plan' have no slope map"):
        _ = result.slope_map
    with pytest.raises(InputError, match="option 'jobs' is not one of the kind 'photogrammetry-plan'; it has none"):
        hg.measure(tmp_path, jobs=1)


@pytest.mark.parametrize(
    ("instrument", "words"), [("screen", "has no synthetic"), ("observr", "did you mean observer")]
)
def test_synthetic_data_that_are_not_there(instrument: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        hg.synth(instrument, tmp_path / "m")


def test_synthetic_measurements_load(tmp_path: Path) -> None:
    folder = hg.synth("heliostat", tmp_path / "m", preset="faulty", seed=1)
    assert hg.load(folder).model.kind == "heliostat"


def test_a_measurement_that_fills_its_folder_itself(tmp_path: Path) -> None:
    folder = hg.synth("heliostat", tmp_path / "m")
    result = hg.measure(folder, thorough=False, jobs=1, only="H01,H02")
    assert result.kind == "heliostat-field"
    assert sorted(result.tables["field"]["heliostat"]) == ["H01", "H02"]
    assert result.doubts == hg.open(result.folder).doubts


@pytest.mark.parametrize("one", [one for one in instruments() if one.synth], ids=lambda one: one.name)
def test_all_synthetic_measurements_are_asked_for_alike(one: Instrument) -> None:
    given = signature(resolve(one.synth)).parameters
    assert list(given) == ["folder", "preset", "seed", "force", "progress"]


@pytest.mark.slow
def test_reports_from_python(result: hg.Result, tmp_path: Path) -> None:
    out = result.save(tmp_path / "out")
    assert hg.report(out) == out / "report.html"
    assert (out / "report.html").stat().st_size > 10_000


def test_it_shows_itself_in_a_notebook(result: hg.Result) -> None:
    text = result._repr_html_()
    assert "<img" in text
    assert "sdx_rad" in text
    assert "0.2721 ± 0.0019 mrad" in text
    assert len(text) < 250_000


def test_angles_of_the_normal_mean_the_same_for_all(result: hg.Result) -> None:
    """SDx is their RMS; on this flat facet the sigma of the angle is that of the slope."""
    angles = result.angles
    assert float(np.sqrt((angles["angle_x"] ** 2).mean())) == pytest.approx(result.summary["sdx_rad"], rel=0.02)
    known = np.isfinite(angles["angle_x"].values)
    np.testing.assert_allclose(
        angles["sigma_angle_x"].values[known], result.slope_map["sigma_slope_x"].values[known], rtol=1e-4
    )
    assert angles["angle_x"].attrs["units"] == "rad"


def test_plots_are_figures(result: hg.Result, tmp_path: Path) -> None:
    result.plot().savefig(tmp_path / "map.png")
    assert "Height" in [text.get_text() for text in result.plot("height").texts]
    with pytest.raises(InputError, match="quantity 'heigth' is not in it; did you mean height"):
        result.plot("heigth")


def test_a_trough_with_slopes_across_only_is_drawn(result: hg.Result, tmp_path: Path) -> None:
    """Its map has no magnitude; theta_r, which the Observer keeps in a file of its own, is drawn, too."""
    trough = hg.open(result.save(tmp_path / "trough"))
    known = read_slope_map(trough.folder / "slope_map.nc")
    across_only = replace(known, slope_y=np.full(known.shape, np.nan))
    write_slope_map(trough.folder / "slope_map.nc", {"": across_only})
    theta = -0.002 * np.where(known.valid, 1.0, np.nan)
    write_angles(trough.folder / "angles.nc", across_only, AngleMaps(theta, theta, np.abs(theta), across_only))
    assert "Slope error in x" in [text.get_text() for text in trough.plot().texts]
    assert "Slope error across the trough" in [text.get_text() for text in trough.plot("theta_r").texts]
    seen = np.isfinite(known.slope_x)
    np.testing.assert_allclose(trough.angles["angle_x"].values[seen], known.slope_error_x[seen], rtol=1e-4)
    np.testing.assert_allclose(trough.angles["sigma_angle_x"].values[seen], known.sigma_slope()[0][seen], rtol=1e-4)
    assert not np.isfinite(trough.angles["angle_y"].values).any()
    with pytest.raises(InputError, match="'theta_b' is not in it; did you mean theta_"):
        trough.plot("theta_b")


def test_parts_are_results_within_results(tmp_path: Path) -> None:
    folder = hg.synth("heliostat", tmp_path / "m")
    field = hg.measure(folder, thorough=False, jobs=1, only="H01,H02")
    assert list(field.parts) == ["H01", "H02"]
    assert field.parts["H02"].kind == "heliostat"
    with pytest.raises(InputError, match="'H03' is not among these; there are: H01, H02"):
        field.parts["H03"]
