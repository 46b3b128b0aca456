"""Slopes of other programs: in, on a grid, and against what they were made of."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import heliogauge as hg
from deflectometry.exchange.measure_slopes import grid_points, load_slopes, run
from deflectometry.exchange.slope_files import import_slopes, read_slopes, read_soltrace
from deflectometry.exchange.slope_points import SlopePoints
from deflectometry.report import sections
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.surfaces import paraboloid, plane
from heliogauge.results.slope_export import export_slope_map
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.tables import write_table_csv
from heliogauge.running import cli


def scattered(n: int = 3000, *, tilt: float = 0.0) -> SlopePoints:
    """Slopes of a paraboloid of f = 10 m with an astigmatism of 1 mrad/m, at points of no order."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.6, 0.6, n), rng.uniform(-0.4, 0.4, n)
    none = np.full(n, np.nan)
    return SlopePoints(x, y, x / 20 + 1e-3 * x + tilt, y / 20 - 1e-3 * y, none, none)


def on_a_grid() -> SlopePoints:
    x, y = (plane.ravel() for plane in np.meshgrid(np.linspace(-0.6, 0.6, 31), np.linspace(-0.4, 0.4, 21)))
    sigma = np.full(x.size, 1e-4)
    return SlopePoints(x, y, x / 20 + 1e-3 * x, y / 20 - 1e-3 * y, sigma, 2 * sigma)


def write(points: SlopePoints, file: Path) -> Path:
    columns = {"x_m": points.x_m, "y_m": points.y_m, "slope_x": points.slope_x, "slope_y": points.slope_y}
    if np.isfinite(points.sigma_x).all():
        columns |= {"sigma_slope_x": points.sigma_x, "sigma_slope_y": points.sigma_y}
    write_table_csv(file, columns)
    return file


def test_points_on_a_grid_stay_as_they_are() -> None:
    points = on_a_grid()
    found = grid_points(points, plane())
    assert found.shape == (21, 31)
    assert found.measured_share == 1.0
    np.testing.assert_allclose(found.slope_x.ravel(), points.slope_x, atol=1e-15)
    np.testing.assert_allclose(found.sigma_random_y.ravel(), points.sigma_y, atol=1e-15)


def test_scattered_points_are_interpolated() -> None:
    found = grid_points(scattered(), paraboloid(10.0), 0.02)
    x, y = np.meshgrid(found.x_m, found.y_m)
    good = found.valid
    assert good.mean() > 0.95
    np.testing.assert_allclose(found.slope_error_x[good], 1e-3 * x[good], atol=1e-12)
    np.testing.assert_allclose(found.slope_error_y[good], -1e-3 * y[good], atol=1e-12)


def test_many_scattered_points_are_no_grid() -> None:
    found = grid_points(scattered(n=20_000), plane())
    assert found.x_m.size * found.y_m.size < 30_000


def test_a_hole_is_not_filled() -> None:
    points = scattered()
    kept = np.hypot(points.x_m, points.y_m) > 0.2
    one = SlopePoints(*(getattr(points, name)[kept] for name in SlopePoints.__slots__))
    found = grid_points(one, plane(), 0.02)
    x, y = np.meshgrid(found.x_m, found.y_m)
    assert not found.valid[np.hypot(x, y) < 0.15].any()
    assert found.aperture[np.hypot(x, y) < 0.15].all()
    assert 0.8 < found.measured_share < 0.9


def test_means_over_cells_are_no_grid_with_holes() -> None:
    """Cells of two by two nodes, smaller at the rim: their means stand on a grid of half a step, one in sixteen."""
    sides = [np.append(np.arange(0.5, last - 1, 2.0), last) * 0.04 for last in (30, 20)]
    x, y = (one.ravel() for one in np.meshgrid(*sides))
    sigma = np.full(x.size, 1e-4)
    found = grid_points(SlopePoints(x, y, x / 20, y / 20, sigma, sigma), paraboloid(10.0))
    assert found.measured_share == 1.0
    assert 0.8 * x.size < found.slope_x.size < 1.25 * x.size
    np.testing.assert_allclose(found.slope_error_x, 0, atol=1e-12)


@pytest.mark.parametrize("missing", ["nodes", "columns"])
def test_missing_nodes_of_a_grid_are_not_filled(missing: str) -> None:
    """A gap that is narrower than the reach of the interpolation is a hole, too."""
    points = on_a_grid()
    column = np.unique(points.x_m, return_inverse=True)[1]
    chance = np.random.default_rng(3).random(column.size)
    inside = (np.abs(points.x_m) < 0.8 * points.x_m.max()) & (np.abs(points.y_m) < 0.8 * points.y_m.max())
    left_out = (inside & (chance < 0.3)) if missing == "nodes" else np.isin(column, (9, 10, 15, 20, 21))
    one = SlopePoints(*(getattr(points, name)[~left_out] for name in SlopePoints.__slots__))
    found = grid_points(one, plane())
    assert found.shape == (21, 31)
    np.testing.assert_array_equal(found.valid.ravel(), ~left_out)
    assert found.aperture.all()


def test_statistics_are_those_of_the_slopes(tmp_path: Path) -> None:
    """RMS of 1 mrad/m over 1.2 m: 0.6 / sqrt(3) mrad, and what sigmas were given."""
    write(on_a_grid(), tmp_path / "mirror.csv")
    import_slopes(tmp_path / "mirror.csv", tmp_path / "m", "slopes", {"design": "paraboloid", "focal_length_m": 10.0})
    result = run(load_slopes(tmp_path / "m"))
    assert not result.doubts
    lines = np.linspace(-0.6, 0.6, 31)
    assert result.numbers["sdx_rad"] == pytest.approx(1e-3 * np.sqrt(np.mean(lines**2)), rel=1e-3)
    assert result.numbers["sd_best_quadratic_rad"] == pytest.approx(0.0, abs=1e-9)
    assert result.numbers["sigma_slope_y_rms_rad"] == pytest.approx(2e-4)
    assert result.numbers["focal_length_x_m"] == pytest.approx(0.5 / (0.05 + 1e-3), rel=1e-6)


@pytest.mark.parametrize(
    ("curvature_per_m", "headline", "shown"),
    [
        (
            -1e-5,
            "x not determined (flat within its sigma: curvature -0.000010 ± 0.000026 1/m)",
            "flat within its sigma",
        ),
        (1e-5, "x not determined (flat within its sigma: curvature 0.000010 ± 0.000026 1/m)", "flat within its sigma"),
        (-1e-3, "x -500 ± 13 m (convex)", "convex"),
        (1e-3, "x 500 ± 13 m   y not", "500 ± 13 m"),
        (0.0, "x not determined (flat within its sigma: curvature 0.000000 ± 0.000026 1/m)", "flat within its sigma"),
    ],
)
def test_a_focus_that_may_have_either_sign_is_said_once_and_alike(
    tmp_path: Path, curvature_per_m: float, headline: str, shown: str
) -> None:
    """Terminal, numbers and report; sigma of the curvature: s / (half width * sqrt(n / 3)) of n slopes."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.6, 0.6, 31), np.linspace(-0.4, 0.4, 21)))
    sigma = np.full(x.size, 2.4e-4)
    write(SlopePoints(x, y, curvature_per_m * x, 0 * y, sigma, sigma), tmp_path / "mirror.csv")
    import_slopes(tmp_path / "mirror.csv", tmp_path / "m", "slopes", {"design": "plane"})
    result = run(load_slopes(tmp_path / "m"))
    summary = result.summarise()
    assert headline in result.headline()
    assert summary.numbers["curvature_x_per_m"] == pytest.approx(curvature_per_m, abs=1e-12)
    assert ("focal_length_x_m" in summary.not_determined) == (abs(curvature_per_m) < 1e-4)
    (tmp_path / "r").mkdir()
    result.write(tmp_path / "r")
    opened = sections.open_results(tmp_path / "r")
    screen = sections.first_screen(opened, sections.slope_view(opened)).text
    assert shown in screen
    assert ("convex" in screen) == (shown == "convex")


def test_rim_points_without_slopes_count_as_not_measured(tmp_path: Path) -> None:
    """31 x 21 points of which the rim has no slopes: 29 x 19 are measured, and the rim is part of the mirror."""
    points = on_a_grid()
    rim = (np.abs(points.x_m) > 0.59) | (np.abs(points.y_m) > 0.39)
    file = write(replace(points, slope_x=np.where(rim, np.nan, points.slope_x)), tmp_path / "mirror.csv")
    import_slopes(file, tmp_path / "m", "slopes", {"design": "paraboloid", "focal_length_m": 10.0})
    result = run(load_slopes(tmp_path / "m"))
    assert result.slope_map.shape == (21, 31)
    assert result.numbers["measured_share"] == pytest.approx(29 * 19 / (31 * 21))
    assert result.points == 29 * 19


def test_one_missing_sigma_costs_that_one_alone(tmp_path: Path) -> None:
    points = on_a_grid()
    holed = replace(points, sigma_x=np.where(np.arange(points.x_m.size) == 100, np.nan, points.sigma_x))
    columns = {name: getattr(holed, name) for name in ("x_m", "y_m", "slope_x", "slope_y")}
    columns |= {"sigma_slope_x": holed.sigma_x, "sigma_slope_y": holed.sigma_y}
    write_table_csv(tmp_path / "mirror.csv", columns)
    import_slopes(tmp_path / "mirror.csv", tmp_path / "m", "slopes", {"design": "paraboloid", "focal_length_m": 10.0})
    result = run(load_slopes(tmp_path / "m"))
    assert [(one.code, one.numbers["missing_count"]) for one in result.doubts] == [("sigma_of_some_slopes_missing", 1)]
    np.testing.assert_allclose(result.slope_map.sigma_random_x, 1e-4, rtol=1e-6)
    np.testing.assert_allclose(result.slope_map.sigma_random_y, 2e-4, rtol=1e-6)


def test_there_and_back_through_soltrace(tmp_path: Path) -> None:
    """The command line: a table in, results with a report, SolTrace's file out, and in again."""

    def leave(*arguments: object) -> int:
        with pytest.raises(SystemExit) as caught:
            cli.main([*map(str, arguments), "-q"])
        return int(caught.value.code or 0)

    write(on_a_grid(), tmp_path / "mirror.csv")
    design = ("--design", "paraboloid", "--focal-length-m", 10)
    assert leave("deflectometry", "import", "slopes", tmp_path / "mirror.csv", "-o", tmp_path / "m", *design) == 0
    assert leave("check", tmp_path / "m") == 0
    assert leave("deflectometry", "measure", tmp_path / "m", "-o", tmp_path / "r") == 0
    assert "SDx" in (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    export_slope_map(tmp_path / "r", tmp_path / "mirror.sht", "soltrace")
    assert leave("deflectometry", "import", "soltrace", tmp_path / "mirror.sht", "-o", tmp_path / "m2", *design) == 0
    again = hg.measure(tmp_path / "m2")
    first = read_slope_map(tmp_path / "r" / "slope_map.nc")
    np.testing.assert_allclose(again.slope_map["slope_x"], first.slope_x, atol=2e-9)
    assert [doubt.code for doubt in again.doubts] == ["sigma_of_slopes_missing"]
    assert (
        leave("deflectometry", "import", "slopes", tmp_path / "r" / "slope_map.nc", "-o", tmp_path / "m3", *design) == 0
    )
    np.testing.assert_allclose(read_slopes(tmp_path / "m3" / "slopes.nc").sigma_x, 1e-4, rtol=1e-6)
    assert [doubt.code for doubt in hg.measure(tmp_path / "m3").doubts] == []
    assert leave("deflectometry", "import", "slopes", tmp_path / "mirror.csv", "-o", tmp_path / "m") == 2
    assert leave("deflectometry", "import", "slopes", tmp_path / "mirror.csv", "-o", tmp_path / "m", "--force") == 0


PARABOLOID = {"design": "paraboloid", "focal_length_m": 10.0}


@pytest.mark.parametrize(
    ("design", "at_import", "code"),
    [
        (None, "no design was given: the slopes are", "slopes_too_far_off_design"),
        ({"design": "plane"}, "the slopes are", "slopes_too_far_off_design"),
        ({"design": "paraboloid", "focal_length_m": 30.0}, "the slopes are", "scan_contradicts_design"),
        ({"design": "paraboloid", "focal_length_m": 11.5}, "the slopes are", "design_curvature_is_not_the_mirrors"),
        (PARABOLOID, "", ""),
        ({"design": "paraboloid", "focal_length_m": 10.2}, "", ""),
    ],
)
def test_a_design_that_is_not_the_mirrors_is_said_with_the_nearest(
    tmp_path: Path, design: dict[str, object] | None, at_import: str, code: str
) -> None:
    """One doubt for one cause, in both axes; a focal length that differs as mirrors do is none."""
    words = import_slopes(write(on_a_grid(), tmp_path / "mirror.csv"), tmp_path / "m", "slopes", design)
    assert at_import in words
    assert ("the best fit is paraboloid of focal length 10 m" in words) == bool(code)
    assert ("--design paraboloid --focal-length-m 10" in words) == bool(code)
    doubts = run(load_slopes(tmp_path / "m")).doubts
    assert [one.code for one in doubts] == ([code] if code else [])
    assert all(one.severity is Severity.SERIOUS for one in doubts if "curvature" not in one.code)
    assert all("focal" in one.text for one in doubts)


def test_slopes_of_no_simple_surface_are_not_told_to_take_the_design_they_have(tmp_path: Path) -> None:
    """Exchanged columns of a trough: a plane is nearest, and is the design already."""
    grid = on_a_grid()
    swapped = write(replace(grid, slope_x=0 * grid.x_m, slope_y=grid.x_m / 3), tmp_path / "mirror.csv")
    import_slopes(swapped, tmp_path / "m", "slopes", {"design": "plane"})
    said = [one.text for one in run(load_slopes(tmp_path / "m")).doubts if one.code == "slopes_too_far_off_design"]
    assert len(said) == 1
    assert "nearest is" not in said[0]
    assert said[0].endswith("no simple surface has these slopes: are slope_x and slope_y exchanged?")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--focal-length-m", "1.49"],
            "--focal-length-m belongs to a paraboloid or trough; add --design paraboloid or ",
        ),
        (["--radius-m", "3"], "--radius-m belongs to a sphere; add --design sphere"),
        (
            ["--design", "sphere", "--radius-m", "3", "--focal-length-m", "2"],
            "--focal-length-m belongs to a paraboloid",
        ),
        (["--design", "trough"], "--design trough needs --focal-length-m"),
    ],
)
def test_a_length_and_its_design_are_named_as_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    file = write(on_a_grid(), tmp_path / "mirror.csv")
    command = ["deflectometry", "import", "slopes", str(file), "-o", str(tmp_path / "m"), *options]
    with pytest.raises(SystemExit, match="2"):
        cli.main(command)
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "m").exists()


def test_the_surface_of_the_file_is_proposed(tmp_path: Path) -> None:
    """The header of a VSHOT file has one, and a map of ours has its own design; neither is taken without a word."""
    x, y = (one.ravel() for one in np.meshgrid(np.linspace(-1.6, 0.0, 17), np.linspace(-0.8, 0.8, 17)))
    rows = np.column_stack([x, y, np.arctan(x / (2 * 1.776) + 2e-3 * np.cos(9 * y)), np.zeros(x.size)])
    lines = ["\t".join(f"{value:.9f}" for value in row) + "\t0" for row in rows.tolist()]
    head = ["title", "0 0 0", f"0 2 {x.size}", "0 0"]
    blank = [*head, *["0.0"] * 6, *lines]
    (tmp_path / "blank.sht").write_text("\n".join(blank), encoding="ascii")
    fitted = read_soltrace(tmp_path / "blank.sht").fitted
    (tmp_path / "m.sht").write_text("\n".join([*head, *map(repr, fitted.tolist()), *lines]), encoding="ascii")
    words = import_slopes(tmp_path / "m.sht", tmp_path / "m", "soltrace")
    assert "the surface in its header is parabolic trough of focal length 1.77" in words
    assert "the best fit is parabolic trough" in import_slopes(tmp_path / "blank.sht", tmp_path / "b", "soltrace")
    assert 'design = "plane"' in (tmp_path / "m" / "measurement.toml").read_text(encoding="utf-8")
    (doubt,) = (one for one in run(load_slopes(tmp_path / "m")).doubts if "design" in one.code)
    assert "--design trough --focal-length-m 1.77" in doubt.text
    with_focal = {"design": "trough", "focal_length_m": 1.49}
    assert "mrad RMS off parabolic trough of focal length 1.49 m" in import_slopes(
        tmp_path / "m.sht", tmp_path / "m", "soltrace", with_focal, force=True
    )
    write(on_a_grid(), tmp_path / "mirror.csv")
    import_slopes(tmp_path / "mirror.csv", tmp_path / "own", "slopes", {"design": "paraboloid", "focal_length_m": 10.3})
    run(load_slopes(tmp_path / "own")).write_files(tmp_path)
    words = import_slopes(tmp_path / "slope_map.nc", tmp_path / "again", "slopes")
    assert "its own design is paraboloid of focal length 10.3 m" in words


def test_shapes_that_have_no_option_are_proposed_as_coefficients(tmp_path: Path) -> None:
    """A convex mirror, and a saddle; three points say nothing."""
    points = on_a_grid()
    for sign, slope_y in ((-1.0, points.y_m / 20), (1.0, -points.y_m / 20)):
        shape = replace(points, slope_x=sign * points.x_m / 20, slope_y=slope_y if sign > 0 else -points.y_m / 20)
        words = import_slopes(write(shape, tmp_path / "m.csv"), tmp_path / "m", "slopes", force=True)
        assert f'design = "quadric", coefficients = [{sign * 0.025:g}, -0.025, 0, 0, ' in words
    few = SlopePoints(*(getattr(points, name)[[0, 5, 300]] for name in SlopePoints.__slots__))
    assert "design" not in import_slopes(write(few, tmp_path / "few.csv"), tmp_path / "few", "slopes")


@pytest.mark.slow
def test_a_map_of_ours_keeps_what_it_knows(tmp_path: Path) -> None:
    """Another design than its own, and a common share of sigma that is lost, are said."""
    result = hg.measure(hg.synth("deflectometry", tmp_path / "facet"), tmp_path / "r")
    import_slopes(result.folder / "slope_map.nc", tmp_path / "plane", "slopes")
    import_slopes(
        result.folder / "slope_map.nc",
        tmp_path / "own",
        "slopes",
        {"design": "paraboloid", "focal_length_m": 100.0},
    )
    plane, own = hg.measure(tmp_path / "plane"), hg.measure(tmp_path / "own")
    assert [doubt.code for doubt in own.doubts] == ["common_share_counts_as_random"]
    assert [doubt.code for doubt in plane.doubts] == ["design_is_not_that_of_the_map", "common_share_counts_as_random"]
    assert own.summary["sd_rad"] == pytest.approx(result.summary["sd_rad"], rel=1e-3)
    assert plane.summary["sd_rad"] > 3 * own.summary["sd_rad"]


def test_a_measured_panel_of_soltrace(shared_data: Path) -> None:
    """A fit to its points returns the coefficients of its header."""
    file = shared_data / "csp" / "soltrace" / "vshot_trough_panel.sht"
    if not file.is_file():
        pytest.skip("SolTrace's files (../shared/data/csp/soltrace) are not on this machine")
    vshot = read_soltrace(file)
    assert vshot.points.x_m.size == 4373
    assert grid_points(vshot.points, plane()).measured_share > 0.99
    np.testing.assert_allclose(vshot.coefficients, [0, -0.008128, -0.000381, -0.000916, 0.000492, 0.140740])
    np.testing.assert_allclose(vshot.fitted, vshot.coefficients, atol=1e-6)
    assert vshot.contradiction == ""


def vshot_text(header: list[float], scale: float = 1.0) -> str:
    """Points of z = 0.01 y + 0.02 x + 0.03 y^2 + 0.05 x y + 0.1 x^2, their angles in another unit."""
    x, y = (plane.ravel() for plane in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-0.5, 0.5, 7)))
    angles = np.arctan(0.02 + 0.05 * y + 0.2 * x), np.arctan(0.01 + 0.06 * y + 0.05 * x)
    points = np.column_stack([x, y, *(scale * one for one in angles)])
    rows = ["\t".join(f"{value:.9f}" for value in point) + "\t0" for point in points.tolist()]
    return "\n".join(["title", "0 0 0", f"0 2 {x.size}", "0 0", *(f"{value:.6f}" for value in header), *rows]) + "\n"


@pytest.mark.parametrize(
    ("header", "scale", "said"),
    [
        ([1.5, 0.01, 0.02, 0.03, 0.05, 0.1], 1.0, ""),
        ([0, 0, 0, 0, 0, 0], 1.0, ""),
        ([0, 0.01, 0.02, 0.03, 0.05, 0.11], 1.0, "x^2 y^0 has 0.11 there, and 0.1 in a fit"),
        ([0, 0.02, 0.01, 0.03, 0.05, 0.1], 1.0, "x^0 y^1 has 0.02 there, and 0.01 in a fit"),
        ([0, 0.01, 0.02, 0.1, 0.05, 0.1], 1.0, "x^0 y^2 has 0.1 there, and 0.03 in a fit"),
        # Milliradians would have been refused; these are halves of angles.
        ([0, 0.01, 0.02, 0.03, 0.05, 0.1], 0.5, "Are the angles in radians"),
    ],
)
def test_a_header_that_is_not_the_surface_of_its_points_is_said(
    tmp_path: Path, header: list[float], scale: float, said: str
) -> None:
    (tmp_path / "m.sht").write_text(vshot_text(header, scale), encoding="ascii")
    words = import_slopes(tmp_path / "m.sht", tmp_path / "m", "soltrace")
    assert ("its header is not" in words) == bool(said)
    assert said in words


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a VSHOT file"),
        (
            "0.0\t1.0\n0.4\t0.9991\n0.8\t0.9953\n",
            r"not a VSHOT file of SolTrace \(\.sht\): its third line .*'0.8 0.9953'",
        ),
        ("a\n0 0 0\n0 0 2\n0 0\n0\n0 0 0 0 0\n", "1 points .* line 3 says 2"),
        ("a\n0 0 0\n0 0 1\n0 0\n0\n0 0 2 0 0\n", "angles of slopes are in radians"),
        ("a\n0 0 0\n0 0 1\n0 0\n0\n0 0 nan 0 0\n", "line 3 says 1"),
    ],
)
def test_what_is_no_vshot_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "m.sht").write_text(text, encoding="ascii")
    with pytest.raises(InputError, match=message):
        import_slopes(tmp_path / "m.sht", tmp_path / "m", "soltrace")
    assert not (tmp_path / "m").exists()


def test_points_on_a_line_are_no_surface() -> None:
    x = np.linspace(0, 1, 50)
    none = np.full(50, np.nan)
    with pytest.raises(EstimationError, match="on one line"):
        grid_points(SlopePoints(x, x, x, x, none, none), plane())


def test_a_table_without_slopes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("x_m,y_m,slope_x\n0,0,0\n", encoding="utf-8")
    with pytest.raises(InputError, match="slope_y"):
        read_slopes(tmp_path / "m.csv")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1e308,0,0,0,1e-4,1e-4", r"m.csv: x = 1e\+308 \(1 such values\); metres"),
        ("1,0,0,-1e20,1e-4,1e-4", r"slope_y = -1e\+20"),
        ("1,0,0,0,-1,1e-4", r"sigma_slope_x = -1 "),
    ],
)
def test_numbers_that_no_mirror_has_are_named(tmp_path: Path, row: str, message: str) -> None:
    head = "x_m,y_m,slope_x,slope_y,sigma_slope_x,sigma_slope_y\n0,0,0,0,1e-4,1e-4\n0,1,0,0,1e-4,1e-4\n"
    (tmp_path / "m.csv").write_text(f"{head}{row}\n", encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_slopes(tmp_path / "m.csv")


@pytest.mark.parametrize("step_m", [1e-12, 1e-303, 5e-324])
def test_a_step_that_no_memory_holds_is_refused(step_m: float) -> None:
    x, y = np.array([0.0, 1.0, 0.0, 1.1]), np.array([0.0, 0.0, 1.0, 1.2])
    none = np.full(4, np.nan)
    with pytest.raises(InputError, match="grid_step_mm"):
        grid_points(SlopePoints(x, y, 0 * x, 0 * x, none, none), plane(), step_m)
