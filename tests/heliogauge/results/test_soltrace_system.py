"""Systems of SolTrace: read, written, and traced by SolTrace's own formulas, with a parser of its own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from deflectometry.cli import app
from deflectometry.exchange.slope_files import read_soltrace
from deflectometry.exchange.soltrace_import import slope_file_of_system
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.results.folder import Summary, write_slope_map, write_summary
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.soltrace_export import SystemChoices, export_system, sun_of_words
from heliogauge.results.soltrace_files import read_system, write_sun, write_system
from heliogauge.results.sun_tables import read_sun
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.sunlight.soltrace_system import aim_and_turn, placed
from heliogauge.sunlight.sun_shapes import BuieSun, GaussianSun, PillboxSun
from heliogauge.validate import FloatArray

FOCAL_M, WIDTH_M, TUBE_M = 1.71, 5.774, 0.070


def spencer_murty(origin: FloatArray, aim: FloatArray, turn_deg: float) -> FloatArray:
    """The matrix from reference to local, element by element as SolTrace's core has it."""
    d = (aim - origin) / np.linalg.norm(aim - origin)
    a, b, g = np.arctan2(d[0], d[2]), np.arcsin(d[1]), np.radians(turn_deg)
    ca, cb, cg, sa, sb, sg = np.cos(a), np.cos(b), np.cos(g), np.sin(a), np.sin(b), np.sin(g)
    return np.array(
        [
            [ca * cg + sa * sb * sg, -cb * sg, -sa * cg + ca * sb * sg],
            [ca * sg - sa * sb * cg, cb * cg, -sa * sg - ca * sb * cg],
            [sa * cb, sb, ca * cb],
        ]
    )


def result_of(
    folder: Path,
    x: FloatArray,
    y: FloatArray,
    slopes: FloatArray,
    height: FloatArray,
    inside: FloatArray | None = None,
    design: FloatArray | None = None,
) -> Path:
    """Write a folder of results with one map."""
    folder.mkdir()
    zero = np.zeros(height.shape)
    known = np.ones(height.shape, bool) if inside is None else inside.astype(bool)
    values = [np.where(known, one, np.nan) for one in slopes]
    one = SlopeMap(
        x,
        y,
        *values,
        *(slopes if design is None else design),
        zero,
        zero,
        1.0,
        no_common_modes(),
        height,
        zero.astype(np.uint32),
        known,
        "drawn",
        "drawn",
        "nothing",
    )
    write_slope_map(folder / "slope_map.nc", {"": one})
    write_summary(folder / "summary.json", Summary("slopes", "drawn", {"measured_share": 1.0}))
    return folder


def trough_result(folder: Path, sigma_rad: float, seed: int) -> Path:
    """A trough with Gaussian slope errors of the normal, across and along."""
    rng = np.random.default_rng(seed)
    x = ((np.arange(60) + 0.5) / 60 - 0.5) * WIDTH_M
    y = ((np.arange(66) + 0.5) / 66 - 0.5) * 6.0
    grid, _ = np.meshgrid(x, y)
    errors = sigma_rad * rng.standard_normal((2, *grid.shape))
    slopes = np.stack([np.tan(np.arctan(grid / (2 * FOCAL_M)) + errors[0]), errors[1]])
    return result_of(folder, x, y, slopes, grid**2 / (4 * FOCAL_M), design=np.stack([grid / (2 * FOCAL_M), 0 * grid]))


def parsed(path: Path) -> tuple[dict[str, list[float]], list[list[str]]]:
    """Read a system line by line with nothing of ours: errors of optics by name, and elements."""
    lines = path.read_text().split("\n")
    assert lines[0].startswith("# SOLTRACE VERSION 3.0")
    optics, elements = {}, []
    for number, line in enumerate(lines):
        cells = line.split("\t")
        if cells[0] == "OPTICAL PAIR":
            optics[cells[1]] = [float(cell) for cell in lines[number + 1].split("\t")[5:9]]
        if len(cells) == 30:
            elements.append(cells)
    assert f"ELEMENTS\t{len(elements)}\t" in "".join(lines[: lines.index("measured mirror")])
    return optics, elements


def traced_intercept(path: Path, sun_mrad: float, rays: int, seed: int) -> float:
    """Share of reflected rays that meet the tube: surface v with its polynomial, tube t, sun and errors as in SolTrace.

    Between the points the slopes are the polynomial's with what the nearest point has beside it.
    """
    rng = np.random.default_rng(seed)
    optics, (mirror, tube) = parsed(path)
    rows = (path.parent / mirror[26]).read_text().split("\n")
    order, count = (int(cell) for cell in rows[2].split()[1:3])
    first = 4 + (order + 1) * (order + 2) // 2
    powers = [(m, k - m) for k in range(order + 1) for m in range(k + 1)]
    header = [(float(row), *power) for row, power in zip(rows[4:first], powers, strict=True)]
    table = np.array([row.split() for row in rows[first : first + count]], float)
    origin = np.array(mirror[1:4], float)
    width, height = (float(cell) for cell in mirror[9:11])
    x, y = (rng.random((2, rays)) - 0.5) * [[width], [height]]

    def gradient(u: FloatArray, v: FloatArray) -> FloatArray:
        by_x = sum(b * m * u ** (m - 1) * v**n for b, m, n in header if m)
        return np.stack([by_x, sum(b * n * u**m * v ** (n - 1) for b, m, n in header if n)])

    z = sum(b * x**m * y**n for b, m, n in header)
    # One point of the table for each place: that of its cell, as the points stand on a lattice.
    columns, lines = np.unique(table[:, 0]), np.unique(table[:, 1])
    lattice = np.full((lines.size, columns.size, 2), np.nan)
    lattice[np.searchsorted(lines, table[:, 1]), np.searchsorted(columns, table[:, 0])] = (
        np.tan(table[:, 2:4]) - gradient(*table[:, :2].T).T
    )
    near = [
        np.clip(np.rint((v - g[0]) / (g[1] - g[0])).astype(int), 0, g.size - 1) for v, g in ((x, columns), (y, lines))
    ]
    normal = np.stack([*-(gradient(x, y) + lattice[near[1], near[0]].T), np.ones(rays)])
    normal /= np.linalg.norm(normal, axis=0)
    # The sun's cone, and slope errors of the optics about the normal.
    light = np.stack([*(1e-3 * sun_mrad * rng.standard_normal((2, rays))), np.ones(rays)])
    light /= np.linalg.norm(light, axis=0)
    normal[:2] += 1e-3 * optics[mirror[27]][2] * rng.standard_normal((2, rays))
    normal /= np.linalg.norm(normal, axis=0)
    beam = 2 * np.sum(normal * light, axis=0) * normal - light
    radius = 1 / float(tube[18])
    # The tube's axis lies one radius from its origin along its z, which points down.
    axis = float(tube[3]) - radius
    place = np.stack([x + origin[0], z + origin[2] - axis])
    across = beam[[0, 2]] / np.hypot(beam[0], beam[2])
    return float(np.mean(np.abs(place[0] * across[1] - place[1] * across[0]) < radius))


@pytest.mark.parametrize(("sigma_mrad", "reference"), [(2, 0.9979), (3, 0.9828), (4, 0.9443), (6, 0.8228)])
def test_exported_trough_has_the_intercept_of_the_core(tmp_path: Path, sigma_mrad: int, reference: float) -> None:
    result = trough_result(tmp_path / "result", 1e-3 * sigma_mrad, sigma_mrad)
    out = tmp_path / "trough.stinput"
    export_system(result, out, SystemChoices("gaussian:2.73", tube_diameter_m=TUBE_M, tube_height_m=FOCAL_M))
    found = traced_intercept(out, 2.73, 60_000, 1)
    # 4000 points of the surface and 1e5 hits of the reference: binomial sigmas of both.
    sigma = np.sqrt(reference * (1 - reference) * (1 / 4000 + 1e-5))
    assert abs(found - reference) < 3.3 * sigma


def test_means_over_nodes_keep_the_spread_of_the_beam(tmp_path: Path) -> None:
    result = trough_result(tmp_path / "result", 4e-3, 7)
    out = tmp_path / "trough.stinput"
    choices = SystemChoices("gaussian:2.73", tube_diameter_m=TUBE_M, tube_height_m=FOCAL_M, points=450)
    said = export_system(result, out, choices)
    optics, _ = parsed(out)
    # Of blocks of 9 nodes means keep a ninth of the variance; the rest is the slope error of the optics.
    assert optics["mirror 1"][2] == pytest.approx(4 * np.sqrt(8 / 9), rel=0.1)
    assert any("became" in line for line in said)


def test_a_trough_with_slopes_across_only_takes_the_design_along(tmp_path: Path) -> None:
    result = trough_result(tmp_path / "result", 2e-3, 3)
    known = read_slope_map(result / "slope_map.nc")
    write_slope_map(result / "slope_map.nc", {"": replace(known, slope_y=np.full(known.shape, np.nan))})
    out = tmp_path / "trough.stinput"
    said = export_system(result, out, SystemChoices("gaussian:2.73", tube_diameter_m=TUBE_M, tube_height_m=FOCAL_M))
    assert any("dz/dy is the design's at all nodes" in line for line in said)
    points = read_soltrace(tmp_path / "trough_1.sht").points
    np.testing.assert_allclose(points.slope_x, known.slope_x[known.valid], atol=1e-7)
    assert not points.slope_y.any()
    # Slopes along matter little to a trough: the reference with errors in both.
    assert abs(traced_intercept(out, 2.73, 20_000, 1) - 0.9979) < 3.3 * np.sqrt(0.9979 * 0.0021 / 4000)


def test_frames_are_those_of_spencer_and_murty() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        origin, aim, turn = rng.normal(size=3), rng.normal(size=3), float(rng.uniform(-179, 179))
        frame = placed(origin, aim, turn)
        assert np.allclose(frame.rotation.T, spencer_murty(origin, aim, turn), atol=1e-12)
        found, back = aim_and_turn(frame, 3.0)
        assert back == pytest.approx(turn, abs=1e-9)
        assert np.allclose(placed(found, origin, 0).rotation[:, 2], -frame.rotation[:, 2])
    turned = RigidTransform(rotation_from_vector(np.array([-0.5 * np.pi, 0, 0])), np.zeros(3))
    aim, turn = aim_and_turn(turned)
    assert np.allclose(placed(np.zeros(3), aim, turn).rotation, turned.rotation, atol=1e-9)


@pytest.mark.parametrize("name", ["ls2_ideal", "ls3_70mm"])
def test_real_systems_come_back_as_they_were(shared_data: Path, tmp_path: Path, name: str) -> None:
    given = shared_data / "csp" / "soltrace" / f"{name}.stinput"
    write_system(tmp_path / given.name, read_system(given))

    def numbers(path: Path) -> list[list[str | float]]:
        rows = [line.split("\t") for line in path.read_text().replace("\r", "").strip("\n").split("\n")]
        rows = [row for row in rows if not row[0].startswith("#")]
        # A pillbox has no sigma: SolTrace keeps what was there before.
        rows[0][6] = ""
        return [[_number(cell) for cell in row] for row in rows]

    assert numbers(tmp_path / given.name) == numbers(given)


def _number(cell: str) -> str | float:
    try:
        return float(cell)
    except ValueError:
        return cell


def test_facets_are_elements_where_they_hang(tmp_path: Path) -> None:
    """Two canted facets with a gap between: each stands at its middle, with its canting in its slopes."""
    x, y = np.linspace(-1.05, 1.05, 85), np.linspace(-0.5, 0.5, 41)
    grid, _ = np.meshgrid(x, y)
    side = np.sign(grid)
    slopes = np.stack([0.02 * side + 0 * grid, 0 * grid])
    inside = np.abs(grid) > 0.06
    result = result_of(tmp_path / "result", x, y, slopes, 0.02 * np.abs(grid), inside)
    out = tmp_path / "two.stinput"
    export_system(result, out, SystemChoices(target_distance_m=50.0, target_size_m=3.0))
    _, (left, right, target) = parsed(out)
    assert float(left[1]) == pytest.approx(-0.5625, abs=1e-6)
    assert float(left[3]) == pytest.approx(0.02 * 0.5625, abs=1e-6)
    assert float(right[9]) == pytest.approx(1.0, abs=0.03)
    assert float(target[3]) == 50.0
    table = (tmp_path / right[26]).read_text().split("\n")
    assert float(table[19].split("\t")[2]) == pytest.approx(np.arctan(0.02), abs=1e-8)
    # The way back, element by element.
    assert slope_file_of_system(out, 2).name == "two_2.sht"
    with pytest.raises(InputError, match="give element=1 to 2"):
        slope_file_of_system(out)


def test_suns_come_back(shared_data: Path, tmp_path: Path) -> None:
    given = read_sun(shared_data / "csp" / "soltrace" / "CSR20.sun")
    write_sun(tmp_path / "again.sun", given)
    angles = np.linspace(0, 0.03, 500)
    assert np.allclose(read_sun(tmp_path / "again.sun").radiance(angles), given.radiance(angles), atol=1e-6)
    buie = BuieSun(0.05)
    write_sun(tmp_path / "buie.sun", buie)
    assert np.abs(read_sun(tmp_path / "buie.sun").radiance(angles) - buie.radiance(angles)).max() < 0.35
    assert isinstance(sun_of_words("pillbox:4.65"), PillboxSun)
    assert isinstance(sun_of_words("gaussian:2.73"), GaussianSun)
    with pytest.raises(InputError, match="pillbox:MRAD"):
        sun_of_words("buie")


@pytest.mark.parametrize(
    ("line", "new", "message"),
    [
        (0, "SUN\tPTSRC\t0", "too few cells"),
        (2, "USER SHAPE DATA\tmany", "USER SHAPE DATA"),
        (5, "OPTICAL\tg\t3", "3 cells"),
        (13, "1\t0\t0", "an element has 3 cells"),
    ],
)
def test_a_damaged_system_is_refused_with_its_line(
    shared_data: Path, tmp_path: Path, line: int, new: str, message: str
) -> None:
    rows = (shared_data / "csp" / "soltrace" / "ls3_70mm.stinput").read_text().split("\n")
    rows[line] = new
    file = tmp_path / "damaged.stinput"
    file.write_text("\n".join(rows))
    with pytest.raises(InputError, match=message):
        read_system(file)


ELEMENT = "1 0 0 0 0 0 1 0 r 2 2 0 0 0 0 0 0 p 0.05 0.05 0 0 0 0 0 0 - glass 2 mirror"
STAGE = "STAGE XYZ 0 0 {} AIM 0 0 9 ZROT 0 VIRTUAL {} MULTIHIT 1 ELEMENTS {} TRACETHROUGH 0"


def element(**cells: str) -> str:
    """An element's line, cells changed by their number ("-": empty)."""
    line = ELEMENT.split()
    for number, cell in cells.items():
        line[int(number.removeprefix("c"))] = cell
    return "\t".join("" if cell == "-" else cell for cell in line)


def system(file: Path, *stages: tuple[int, list[str]], separator: str = "\t", table: str = "") -> Path:
    """Write a system of SolTrace: whether each stage is virtual, and its elements."""
    optic = "\t".join(["OPTICAL", "g", "3", "1", "4", "0.9", "0", "0.5", "0.2", "1", "1", "0", "0", "0", "0"])
    lines = [
        "# SOLTRACE VERSION 2012.7.9 INPUT FILE",
        separator.join(["SUN", "PTSRC", "0", "SHAPE", "p", "SIGMA", "2.73", "HALFWIDTH", "4.65"]),
        separator.join(["XYZ", "0", "0", "100", "USELDH", "0", "LDH", "0", "0", "0"]),
        f"USER SHAPE DATA{separator}0",
        f"OPTICS LIST COUNT{separator}1",
        "OPTICAL PAIR\tglass",
        optic + table,
        *(["0 1", "900 0.5"] if table else []),
        optic,
        f"STAGE LIST COUNT{separator}{len(stages)}",
    ]
    for number, (virtual, elements) in enumerate(stages):
        lines += [separator.join(STAGE.format(number, virtual, len(elements)).split()), "", *elements]
    file.write_text("\n".join(lines) + "\n")
    return file


def test_what_soltrace_reads_is_read(tmp_path: Path) -> None:
    """Lines that SolTrace scans for numbers may have any spaces; cells of others may be empty, the last one missing."""
    empty = element(c27="-")
    found = read_system(system(tmp_path / "a.stinput", (0, [element()]), (1, [empty, element(c27="of old")]), (0, [])))
    assert [len(stage.elements) for stage in found.stages] == [1, 2, 0]
    assert [one.optics for one in found.stages[1].elements] == ["", "of old"]
    # What is read can be written, and read again.
    write_system(tmp_path / "again.stinput", found)
    assert read_system(tmp_path / "again.stinput").stages[1].elements[0].optics == ""
    # An element that is off needs neither optics nor a direction.
    off = element(c0="0", c27="-", c6="0")
    assert not read_system(system(tmp_path / "off.stinput", (0, [off]))).stages[0].elements[0].is_on
    spaced = read_system(system(tmp_path / "b.stinput", (0, [element()]), separator="   "))
    assert (spaced.stages[0].elements[0].surface_numbers[0], spaced.sun.towards_m[2]) == (0.05, 100.0)
    bare = read_system(
        system(tmp_path / "c.stinput", (0, [element(c8="-", c17="-", c16="-").removesuffix("\tmirror")]))
    )
    one = bare.stages[0].elements[0]
    assert (one.aperture, one.surface, one.aperture_m[7], one.comment) == ("r", "f", 0.0, "")
    assert len(read_system(system(tmp_path / "d.stinput", (0, [element()]), table="\t1\t2\t0\t0")).optics) == 1


def test_elements_that_rays_meet_have_optics(tmp_path: Path) -> None:
    for bad in (element(c27="-"), element(c27="steel")):
        with pytest.raises(InputError, match=r"optics .*, which are not there"):
            read_system(system(tmp_path / "a.stinput", (0, [bad])))
    with pytest.raises(InputError, match="are one point"):
        read_system(system(tmp_path / "b.stinput", (0, [element(c6="0")])))
    with pytest.raises(InputError, match="line 7"):
        read_system(system(tmp_path / "c.stinput", (0, [element()]), table="\t1\tmany"))
    text = system(tmp_path / "d.stinput", (0, [element()])).read_text()
    (tmp_path / "d.stinput").write_text(text.replace("STAGE LIST COUNT\t1", "STAGE LIST COUNT\t" + "9" * 5000))
    with pytest.raises(InputError, match="STAGE LIST COUNT"):
        read_system(tmp_path / "d.stinput")


def test_commands(shared_data: Path, tmp_path: Path) -> None:
    result = trough_result(tmp_path / "result", 1e-3, 0)
    out = tmp_path / "t.stinput"
    command = ["export", "soltrace", str(result), "-o", str(out), "--tube-diameter-mm", "70", "--tube-height-m", "1.71"]
    ended = CliRunner().invoke(app, command)
    assert ended.exit_code == 0
    assert "sigmas of the slopes" in ended.stdout
    ended = CliRunner().invoke(app, ["import", "soltrace", str(out), "-o", str(tmp_path / "back")])
    assert ended.exit_code == 0
    assert (tmp_path / "back" / "slopes.csv").is_file()
    with pytest.raises(InputError, match=r"no element has measured slopes.*cylinder of radius 0.035 m"):
        slope_file_of_system(shared_data / "csp" / "soltrace" / "ls3_70mm.stinput")
