"""Slope maps in the form of other programs, read back by those programs' own formulas."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deflectometry.exchange.slope_files import read_soltrace
from deflectometry.exchange.surface_files import read_surface
from heliogauge.errors import InputError
from heliogauge.results.slope_export import export_slope_map, fit_monomials
from heliogauge.results.slope_map_file import write_slope_map
from heliogauge.slopes.map import SlopeMap, no_common_modes

CURVATURE = 0.05


def a_map(*, heights: bool = True) -> SlopeMap:
    """A saddle-like mirror with a hole, whose x and y cannot be mistaken for each other."""
    x_m, y_m = np.linspace(-0.6, 0.6, 25), np.linspace(-0.4, 0.5, 19)
    x, y = np.meshgrid(x_m, y_m)
    z = CURVATURE * x**2 + 0.02 * x * y + 0.01 * y**2 + 0.003 * x**3
    hole = (np.abs(x) < 0.1) & (np.abs(y) < 0.1)
    slope_x = np.where(hole, np.nan, 2 * CURVATURE * x + 0.02 * y + 0.009 * x**2)
    slope_y = np.where(hole, np.nan, 0.02 * x + 0.02 * y)
    none = np.zeros_like(x)
    return SlopeMap(
        x_m,
        y_m,
        slope_x,
        slope_y,
        2 * CURVATURE * x,
        none,
        none + 1e-5,
        none + 2e-5,
        1.0,
        no_common_modes(),
        z if heights else np.full_like(z, np.nan),
        np.where(hole, 2, 0).astype(np.uint32),
        np.ones_like(x, dtype=bool),
        "plane",
        "facet",
        "nothing",
    )


@pytest.fixture
def result(tmp_path: Path) -> Path:
    folder = tmp_path / "result"
    folder.mkdir()
    write_slope_map(folder / "slope_map.nc", {"facet": a_map()})
    return folder


def soltrace(file: Path) -> tuple[dict[tuple[int, int], float], np.ndarray]:
    """Read a VSHOT file line by line, as SolTrace's core does: B(k, m) of x^m y^(k-m), then the points."""
    lines = iter(file.read_text(encoding="ascii").splitlines())
    next(lines), next(lines)
    order, count = (int(text) for text in next(lines).split()[1:])
    next(lines)
    table = {(m, k - m): float(next(lines)) for k in range(order + 1) for m in range(k + 1)}
    points = np.array([[float(text) for text in line.split()] for line in lines])
    assert points.shape == (count, 5)
    return table, points


def test_soltrace_reads_heights_and_normals(result: Path, tmp_path: Path) -> None:
    export_slope_map(result, tmp_path / "new" / "mirror.sht", "soltrace")
    table, points = soltrace(tmp_path / "new" / "mirror.sht")
    x, y = points[:, 0], points[:, 1]
    z = sum(value * x**i * y**j for (i, j), value in table.items())
    np.testing.assert_allclose(z, CURVATURE * x**2 + 0.02 * x * y + 0.01 * y**2 + 0.003 * x**3, atol=1e-7)
    # The normal is taken from the tangents of the measured angles.
    np.testing.assert_allclose(np.tan(points[:, 2]), 2 * CURVATURE * x + 0.02 * y + 0.009 * x**2, atol=1e-8)
    np.testing.assert_allclose(np.tan(points[:, 3]), 0.02 * x + 0.02 * y, atol=1e-8)
    assert len(points) == a_map().valid.sum()


def across_only(folder: Path) -> SlopeMap:
    """The same mirror with slopes across only, and a design that bends along, too."""
    known = a_map()
    _, y = np.meshgrid(known.x_m, known.y_m)
    unknown = np.full(known.shape, np.nan)
    one = replace(known, slope_y=unknown, sigma_random_y=unknown, design_slope_y=0.02 * y)
    folder.mkdir()
    write_slope_map(folder / "slope_map.nc", {"": one})
    return one


def test_soltrace_takes_the_design_along_where_slopes_are_known_across_only(tmp_path: Path) -> None:
    known = across_only(tmp_path / "result")
    said = export_slope_map(tmp_path / "result", tmp_path / "m.sht", "soltrace")
    assert "dz/dy is the design's at all nodes" in said
    assert "dz/dy is the design's at all nodes" in (tmp_path / "m.sht").read_text().splitlines()[0]
    back = read_soltrace(tmp_path / "m.sht")
    np.testing.assert_allclose(back.points.slope_x, known.slope_x[known.valid], atol=1e-8)
    np.testing.assert_allclose(back.points.slope_y, known.design_slope_y[known.valid], atol=1e-8)
    assert not back.contradiction
    table, _ = soltrace(tmp_path / "m.sht")
    assert table[2, 0] == pytest.approx(CURVATURE, rel=1e-3)
    assert table[0, 2] == pytest.approx(0.01, rel=1e-3)


def test_a_mesh_takes_the_design_along_where_slopes_are_known_across_only(tmp_path: Path) -> None:
    known = across_only(tmp_path / "result")
    assert "dz/dy is the design's" in export_slope_map(tmp_path / "result", tmp_path / "m.ply", "ply")
    assert b"comment metres; heliogauge; dz/dy is the design's at all nodes" in (tmp_path / "m.ply").read_bytes()
    back = read_surface(tmp_path / "m.ply")
    np.testing.assert_allclose(back.slope_x, known.slope_x[known.valid], atol=1e-6)
    np.testing.assert_allclose(back.slope_y, known.design_slope_y[known.valid], atol=1e-6)


def test_the_polynomial_of_a_measured_panel_is_that_of_its_file(shared_data: Path) -> None:
    """A VSHOT measurement: the header's coefficients come back from its slopes."""
    file = shared_data / "csp" / "soltrace" / "vshot_trough_panel.sht"
    if not file.is_file():
        pytest.skip("SolTrace's files (../shared/data/csp/soltrace) are not on this machine")
    text = file.read_text(encoding="latin-1").splitlines()
    table = [float(line) for line in text[4:10]]
    points = np.array([[float(cell) for cell in line.split()] for line in text[10:] if line.strip()])
    found = fit_monomials(points[:, 0], points[:, 1], *np.tan(points[:, 2:4]).T, degree=2)
    # Rising powers of x there, falling ones here.
    wanted = [table[0], *table[1:3][::-1], *table[3:][::-1]]
    np.testing.assert_allclose(found, wanted, atol=1.1e-6)


def test_csv_has_every_node_of_the_mirror(result: Path, tmp_path: Path) -> None:
    export_slope_map(result, tmp_path / "m.csv", "csv")
    with (tmp_path / "m.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    wanted = a_map()
    assert len(rows) == wanted.aperture.sum()
    assert sum(row["slope_x"] == "" for row in rows) == (~wanted.valid).sum()
    assert {row["flag"] for row in rows} == {"0", "2"}
    last = rows[-1]
    assert float(last["slope_y"]) == pytest.approx(wanted.slope_y[-1, -1], abs=1e-8)
    assert float(last["design_slope_x"]) == pytest.approx(wanted.design_slope_x[-1, -1], abs=1e-8)
    assert float(last["sigma_slope_y"]) == pytest.approx(2e-5, rel=1e-5)


def test_ply_is_read_by_open3d_with_its_normals_to_the_front(result: Path, tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    export_slope_map(result, tmp_path / "m.ply", "ply")
    mesh = open3d.io.read_triangle_mesh(str(tmp_path / "m.ply"))
    points, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    assert len(points) == a_map().valid.sum()
    x, y = points[:, 0], points[:, 1]
    np.testing.assert_allclose(points[:, 2], CURVATURE * x**2 + 0.02 * x * y + 0.01 * y**2 + 0.003 * x**3, atol=1e-6)
    np.testing.assert_allclose(-normals[:, 1] / normals[:, 2], 0.02 * x + 0.02 * y, atol=1e-6)
    # Triangles turn as their normals say, and leave the hole open.
    mesh.compute_triangle_normals()
    assert (np.asarray(mesh.triangle_normals)[:, 2] > 0.9).all()
    area = mesh.get_surface_area()
    assert 1.08 * 0.9 < area < 1.08


@pytest.mark.parametrize(
    ("form", "name", "options", "message"),
    [
        ("csv", "result", {}, "a folder; name a file"),
        ("csv", "m.csv", {"facet": "left"}, "facet=left: no such facet"),
        ("soltrace", "mirror.txt", {}, "knows the file by its ending"),
    ],
)
def test_what_cannot_be_is_refused(
    result: Path, tmp_path: Path, form: str, name: str, options: dict[str, str], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        export_slope_map(result, tmp_path / name, form, **options)
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_a_file_is_replaced_only_when_asked(result: Path, tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="force=True"):
        export_slope_map(result, tmp_path / "m.csv", "csv")
    assert (tmp_path / "m.csv").read_text(encoding="utf-8") == "mine"
    export_slope_map(result, tmp_path / "m.csv", "csv", force=True)
    assert (tmp_path / "m.csv").read_text(encoding="utf-8").startswith("x_m,y_m")


def test_a_map_without_heights_is_no_mesh(tmp_path: Path) -> None:
    write_slope_map(tmp_path / "slope_map.nc", {"facet": a_map(heights=False)})
    with pytest.raises(InputError, match="no heights"):
        export_slope_map(tmp_path, tmp_path / "m.ply", "ply")


def test_no_slope_map_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no slope_map\.nc"):
        export_slope_map(tmp_path, tmp_path / "m.csv", "csv")


def test_results_of_several_modules_have_no_map_but_their_folders_have(result: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"1 mirrors have a folder of results each .* as .*result"):
        export_slope_map(tmp_path, tmp_path / "m.csv", "csv")
