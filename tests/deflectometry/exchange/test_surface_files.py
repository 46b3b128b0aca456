"""Measured surfaces: NURBS, PLY and points with normals, against the surfaces they were made of."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from deflectometry.exchange.slope_files import import_slopes, read_slopes
from deflectometry.exchange.surface_files import evaluate_nurbs, fitted_places, read_surface
from heliogauge.errors import InputError
from heliogauge.results.tables import write_table_csv
from heliogauge.running import cli


def nodes() -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of z = 0.05 x^2 + 0.01 x y."""
    x, y = (plane.ravel() for plane in np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.4, 0.4, 9)))
    normals = np.column_stack([-0.1 * x - 0.01 * y, -0.01 * x, np.ones(x.size)])
    return np.column_stack([x, y, 0.05 * x**2 + 0.01 * x * y]), normals / np.linalg.norm(normals, axis=1)[:, None]


def assert_is_the_surface(file: Path) -> None:
    found = read_surface(file)
    assert found.x_m.size == 108
    np.testing.assert_allclose(found.slope_x, 0.1 * found.x_m + 0.01 * found.y_m, atol=1e-6)
    np.testing.assert_allclose(found.slope_y, 0.01 * found.x_m, atol=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_with_normals(tmp_path: Path, form: str, sign: int) -> None:
    points, normals = nodes()
    table = np.column_stack([points, sign * normals])
    header = f"ply\nformat {form} 1.0\nelement vertex {len(table)}\n"
    header += "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")) + "end_header\n"
    order = ">" if "big" in form else "<"
    body = "\n".join(" ".join(map(repr, row)) for row in table.tolist()).encode()
    (tmp_path / "m.ply").write_bytes(
        header.encode() + (body if form == "ascii" else table.astype(order + "f8").tobytes())
    )
    assert_is_the_surface(tmp_path / "m.ply")


def test_points_with_normals(tmp_path: Path) -> None:
    names = ("x_m", "y_m", "z_m", "normal_x", "normal_y", "normal_z")
    write_table_csv(tmp_path / "m.csv", dict(zip(names, np.column_stack(nodes()).T, strict=True)))
    assert_is_the_surface(tmp_path / "m.csv")
    assert "108 points" in import_slopes(tmp_path / "m.csv", tmp_path / "m", "surface")
    assert read_slopes(tmp_path / "m" / "slopes.csv").x_m.size == 108


def test_nurbs_have_the_slopes_of_what_they_are_made_of(tmp_path: Path) -> None:
    """A bilinear parametrisation with quadratic height is exact in a spline: z = 0.05 x^2 + 0.01 x y."""
    # Greville abscissae of clamped uniform knots reproduce x and y; the quadratic's blossom gives z.
    degree, n = 3, 8
    knots = np.r_[np.zeros(degree), np.linspace(0, 1, n - degree + 1), np.ones(degree)]
    three = np.stack([knots[k + 1 : k + 1 + n] for k in range(degree)])
    greville = three.mean(axis=0)
    square = (three[0] * three[1] + three[0] * three[2] + three[1] * three[2]) / 3
    x, y = np.meshgrid(greville - 0.5, greville - 0.5, indexing="ij")
    x2 = np.broadcast_to((square - greville + 0.25)[:, None], x.shape)
    control = np.stack([x, y, 0.05 * x2 + 0.01 * x * y], axis=-1)
    points, normals = evaluate_nurbs(tmp_path, control, [degree, degree])
    np.testing.assert_allclose(points[:, 2], 0.05 * points[:, 0] ** 2 + 0.01 * points[:, 0] * points[:, 1], atol=1e-12)
    np.testing.assert_allclose(-normals[:, 0] / normals[:, 2], 0.1 * points[:, 0] + 0.01 * points[:, 1], atol=1e-12)
    with h5py.File(tmp_path / "s.h5", "w") as file:
        for name in ("A1", "A2"):
            group = file.create_group(f"heliostats/{name}/surface/facets/facet_1")
            group["control_points"], group["degrees"] = control, [degree, degree]
        file.create_group("heliostats/A3/surface/facets")
    with pytest.raises(InputError, match="facets is empty"):
        read_surface(tmp_path / "s.h5", "A3")
    with pytest.raises(InputError, match="3 heliostats"):
        read_surface(tmp_path / "s.h5")
    with pytest.raises(InputError, match="facet=facet_9: not in"):
        read_surface(tmp_path / "s.h5", "A1", "facet_9")
    words = ["--heliostat", "A1", "--facet", "facet_1", "-o", str(tmp_path / "m"), "-q"]
    run_command(["import", "surface", str(tmp_path / "s.h5"), *words])
    assert read_slopes(tmp_path / "m" / "slopes.csv").x_m.size == 3600


def test_normals_of_artist_belong_where_they_were_measured(tmp_path: Path) -> None:
    """On the even lattice of its control points a spline's places are far apart at the rim, its parameters are not."""
    u = np.linspace(0, 1, 20)
    control = np.stack([*np.meshgrid(1.6 * u - 0.8, 1.2 * u - 0.6, indexing="ij"), np.zeros((20, 20))], axis=-1)
    spread, places = evaluate_nurbs(tmp_path, control, [3, 3])[0], fitted_places(control)
    even = (np.arange(60) + 0.5) / 60
    np.testing.assert_allclose(places[::60, 0], 1.6 * even - 0.8, atol=1e-12)
    np.testing.assert_allclose(places[:60, 1], 1.2 * even - 0.6, atol=1e-12)
    # A clamped spline leaves its first control point with degree times the step over the first interval of its knots.
    step = (spread[60, 0] - spread[0, 0]) / (places[60, 0] - places[0, 0])
    assert 2 < step < 3 * 17 / 19


def test_a_real_heliostat_has_the_deviation_of_its_own_sheet(shared_data: Path, tmp_path: Path) -> None:
    """AA39: the sheet of the instrument that measured it prints 1.77 and 1.36 mrad, mean slope removed."""
    file = shared_data / "csp" / "juelich_surface" / "surfaces.h5"
    if not file.is_file():
        pytest.skip("measured surfaces (../shared/data/csp/juelich_surface) are not on this machine")
    off = []
    with h5py.File(file) as content:
        for name, facet in content["heliostats/AA39/surface/facets"].items():
            one = read_surface(file, "AA39", name)
            canted = np.linalg.solve(facet["canting"][:, :2], facet["canting"][:, 2])
            off.append(np.stack([one.slope_x, one.slope_y]) - canted[:, None])
    # The option of the command does the same: normals are turned, not slopes subtracted.
    turned = read_surface(file, "AA39", without_canting=True)
    found = np.stack([turned.slope_x, turned.slope_y])
    np.testing.assert_allclose(found, np.concatenate(off, axis=1), atol=2e-6)
    words = ["--heliostat", "AA39", "--without-canting", "-o", str(tmp_path / "m"), "-q"]
    run_command(["import", "surface", str(file), *words])
    run_command(["measure", str(tmp_path / "m"), "-o", str(tmp_path / "r"), "--remove", "tilt", "--no-report", "-q"])
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())["numbers"]
    np.testing.assert_allclose([1e3 * summary["sdx_rad"], 1e3 * summary["sdy_rad"]], [1.77, 1.36], atol=0.02)


def run_command(words: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", *words])
    assert ended.value.code == 0


def test_only_files_that_say_the_canting_can_be_freed_of_it(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("x_m,y_m,z_m,normal_x,normal_y,normal_z\n0,0,0,0,0,1\n")
    with pytest.raises(InputError, match="say how their facets are canted"):
        read_surface(tmp_path / "m.csv", without_canting=True)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("m.ply", "ply", "its header is not whole"),
        (
            "m.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "x, y, z are needed",
        ),
        ("m.stl", "solid", r"NURBS \(\.h5\), PLY"),
        ("m.csv", "x_m,y_m,z_m,normal_x,normal_y,normal_z\n", "no points with a normal"),
        (
            "m.csv",
            "x_m,y_m,z_m,normal_x,normal_y,normal_z\n0,0,0,0,0,1\n0,0,0,1,0,-1\n1,0,0,0,0,1\n",
            "point the other way",
        ),
    ],
)
def test_what_is_no_surface_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text, encoding="ascii")
    with pytest.raises(InputError, match=message):
        import_slopes(tmp_path / name, tmp_path / "m", "surface")
    assert not (tmp_path / "m").exists()
