"""Scans of the surface: slopes and their sigmas against facets drawn by data_synth, and bad input."""

from pathlib import Path

import numpy as np
import pytest

from data_synth.lasers import PointScene, write_surface_scan
from deflectometry.exchange.slope_files import import_slopes
from deflectometry.scans.keys import load_surface_scan
from deflectometry.scans.pipeline.measure import SurfaceScanResult, run
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.tables import read_columns_csv, write_table_csv

COLUMNS = ("x_m", "y_m", "z_m")
#: Small, and curved enough to know where it is.
TROUGH = PointScene("trough", (("focal_length_m", 1.71),), 1.6, 1.2, 900)
X_AXIS = TROUGH.scanner_from_mirror.rotation[:, 0].tolist()


def scanned(folder: Path, scene: PointScene, seed: int = 0, **keys: object) -> Path:
    write_surface_scan(folder, scene, seed)
    change(folder, **keys)
    return folder


def change(folder: Path, **keys: object) -> None:
    """Set keys of measurement.toml: section__key=value."""
    file = folder / "measurement.toml"
    for name, value in keys.items():
        section, _, key = name.partition("__")
        text = file.read_text().split("\n")
        text = [line for line in text if not line.startswith(f"{key} =")]
        if f"[{section}]" not in text:
            text.append(f"[{section}]")
        shown = str(value).lower() if isinstance(value, bool) else repr(value).replace("'", '"')
        text.insert(text.index(f"[{section}]") + 1, f"{key} = {shown}")
        file.write_text("\n".join(text))


def table(folder: Path) -> dict[str, np.ndarray]:
    return dict(read_columns_csv(folder / "points.csv", (), COLUMNS)[1])


def measured(folder: Path) -> SurfaceScanResult:
    return run(load_surface_scan(folder))


def errors_of(result: SurfaceScanResult, scene: PointScene) -> tuple[np.ndarray, np.ndarray]:
    """Return slope errors (2, n) and their sigmas, without what a motion of the trough does: its place was fitted."""
    one = result.slope_map
    known = one.valid
    x, y = (plane[known] for plane in np.meshgrid(one.x_m, one.y_m))
    _, true_x, true_y = scene.mirror.surface(x, y)
    errors = np.stack([one.slope_x[known] - true_x, one.slope_y[known] - true_y])
    sigmas = np.stack([one.sigma_random_x[known], one.sigma_random_y[known]])
    none, one_ = np.zeros(x.size), np.ones(x.size)
    # Tilts, and the turn about z: slopes turn with the frame and are those of another place.
    moved = np.stack([[one_, none], [none, one_], [y, x]])
    amounts = np.linalg.lstsq(moved.reshape(3, -1).T, errors.ravel(), rcond=None)[0]
    return errors - np.tensordot(amounts, moved, axes=1), sigmas


@pytest.mark.slow
def test_published_estimate_and_what_patches_buy(tmp_path: Path) -> None:
    """V-16: 4,000 points of 0.1 mm on 6 m2: about 3 mrad between neighbours; patches buy a factor of five."""
    result = measured(scanned(tmp_path / "scan", PointScene()))
    numbers = result.numbers
    assert numbers["neighbour_slope_noise_rad"] == pytest.approx(3.65e-3, rel=0.05)
    assert numbers["point_noise_m"] == pytest.approx(1e-4, rel=0.1)
    three_by_three = result.patches[0]
    assert three_by_three.noise_rad[0] == pytest.approx(1.05e-3, rel=0.1)
    best = min(one.total_rad for one in result.patches if np.isfinite(one.total_rad))
    assert best < 1.1e-3
    assert np.nanmax(result.slope_map.sigma_random_x) < 6e-3


@pytest.mark.slow
def test_errors_are_those_of_the_sigmas(tmp_path: Path) -> None:
    ratios = []
    for seed in range(2):
        folder = scanned(tmp_path / f"s{seed}", TROUGH, seed, points__x_axis=X_AXIS)
        errors, sigmas = errors_of(measured(folder), TROUGH)
        ratios.append(np.sqrt(np.mean((errors / sigmas) ** 2)))
    # Below 1: what a patch could lose without being seen is in the sigma.
    assert 0.5 < np.mean(ratios) < 1.1


@pytest.mark.slow
def test_noise_of_means_scatters_as_said(tmp_path: Path) -> None:
    """Sums over the map, of patches that overlap: their scatter over ten scans, whitened with the noise correlation."""
    scene = PointScene("trough", (("focal_length_m", 1.71),), 1.6, 1.2, 900, with_errors=False)
    squares = []
    for seed in range(12):
        folder = scanned(tmp_path / f"s{seed}", scene, seed, points__x_axis=X_AXIS, evaluation__patch_mm=280.0)
        one = measured(folder).slope_map
        known = one.valid
        x = np.meshgrid(one.x_m, one.y_m)[0][known]
        weight = x - x.mean()
        error = (one.slope_x - one.design_slope_x)[known]
        sigma = np.sqrt(one.noise_correlation * np.sum((weight * one.sigma_random_x[known]) ** 2))
        squares.append(float((weight @ (error - error.mean()) / sigma) ** 2))
    # Chi-square of 12: one in a thousand on either side, and the fitted pose takes a share of what it sees.
    assert 1.5 < sum(squares) < 32


def test_pose_and_what_the_shape_leaves_free(tmp_path: Path) -> None:
    result = measured(scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS))
    assert any("y" in words or "0.000, 1.000" in words for words in result.place.held)
    assert {"motions_left_free"} <= {one.code for one in result.doubts}
    found = result.place.mirror_from_points.rotation @ TROUGH.scanner_from_mirror.rotation
    # The facet's own errors tilt the best fit by some mrad.
    assert np.abs(found - np.eye(3)).max() < 5e-3


def test_normals_give_slopes_too(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    points = np.column_stack(list(table(folder).values()))
    place = TROUGH.scanner_from_mirror
    inside = (points - place.translation_m) @ place.rotation
    _, slope_x, slope_y = TROUGH.mirror.surface(inside[:, 0], inside[:, 1])
    normals = np.column_stack([-slope_x, -slope_y, np.ones(len(slope_x))]) @ place.rotation.T
    for sign in (1.0, -1.0):
        columns = dict(zip(("normal_x", "normal_y", "normal_z"), sign * normals.T, strict=True))
        write_table_csv(folder / "points.csv", table(folder) | columns)
        change(folder, points__slopes_from="normals", points__sigma_normal_mrad=0.1)
        result = measured(folder)
        errors, _ = errors_of(result, TROUGH)
        assert np.sqrt(np.mean(errors**2)) < 5e-4
        assert ("normals_turned" in {one.code for one in result.doubts}) == (sign < 0)
    columns["normal_x"][::2] *= -1
    columns["normal_y"][::2] *= -1
    columns["normal_z"][::2] *= -1
    write_table_csv(folder / "points.csv", table(folder) | columns)
    with pytest.raises(InputError, match="normals point the other way"):
        measured(folder)


def test_millimetres_are_refused(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH)
    write_table_csv(folder / "points.csv", {name: 1e3 * column for name, column in table(folder).items()})
    with pytest.raises(InputError, match="are they in millimetres"):
        measured(folder)


@pytest.mark.slow
def test_a_scanner_behind_the_mirror_is_refused(tmp_path: Path) -> None:
    behind = TROUGH.scanner_from_mirror.apply(np.array([0.0, 0.0, -5.0])).tolist()
    folder = scanned(tmp_path / "scan", TROUGH, points__scanner_m=behind)
    with pytest.raises(EstimationError, match="upside down"):
        measured(folder)


@pytest.mark.slow
def test_another_design_is_said(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS, mirror__focal_length_m=4.0)
    doubts = {one.code: one for one in measured(folder).doubts}
    assert "1.7" in doubts["scan_contradicts_design"].text


@pytest.mark.slow
def test_stray_points_are_left_out(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    columns = table(folder)
    stray = np.random.default_rng(0).choice(len(columns["z_m"]), 8, replace=False)
    columns["z_m"][stray] += 0.01
    write_table_csv(folder / "points.csv", columns)
    result = measured(folder)
    (odd,) = (one for one in result.doubts if one.code == "points_odd")
    assert 8 <= odd.numbers["odd_count"] <= 9
    errors, sigmas = errors_of(result, TROUGH)
    assert np.sqrt(np.mean((errors / sigmas) ** 2)) < 1.4


def test_a_ply_without_normals_is_a_scan(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    points = np.column_stack(list(table(folder).values()))
    expected = measured(folder).numbers["sdx_rad"]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property double {name}\n" for name in "xyz") + "end_header\n"
    (folder / "points.ply").write_bytes(head.encode() + (1e3 * points).astype("<f8").tobytes())
    with pytest.raises(InputError, match="points without normals are a scan"):
        import_slopes(folder / "points.ply", tmp_path / "in", "surface")
    change(folder, points__file="points.ply", points__unit="mm")
    assert measured(folder).numbers["sdx_rad"] == pytest.approx(expected, rel=1e-3)
    change(folder, points__slopes_from="normals")
    with pytest.raises(InputError, match="the points have none"):
        measured(folder)


@pytest.mark.slow
def test_e57_is_read(tmp_path: Path) -> None:
    library = pytest.importorskip("pye57")
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    expected = measured(folder).numbers["sdx_rad"]
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), table(folder).values(), strict=True))
    writer = library.E57(str(folder / "points.e57"), mode="w")
    writer.write_scan_raw(columns)
    writer.close()
    change(folder, points__file="points.e57")
    assert measured(folder).numbers["sdx_rad"] == pytest.approx(expected, rel=1e-3)
    (folder / "points.e57").write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="cannot be read as E57"):
        measured(folder)


@pytest.mark.parametrize("count", [9, 90])
def test_strays_metres_off_change_nothing(tmp_path: Path, count: int) -> None:
    """1 % and 10 % of the points anywhere around the mirror: the middle moves with them unless they go first."""
    clean = measured(scanned(tmp_path / "clean", TROUGH, points__x_axis=X_AXIS))
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    points = np.column_stack(list(table(folder).values()))
    strays = points.mean(axis=0) + np.random.default_rng(0).normal(0.0, 1.0, (count, 3))
    write_table_csv(folder / "points.csv", dict(zip(COLUMNS, np.concatenate([points, strays]).T, strict=True)))
    result = measured(folder)
    assert result.numbers["sdx_rad"] == pytest.approx(clean.numbers["sdx_rad"], rel=0.05)
    assert result.numbers["sigma_sdx_rad"] == pytest.approx(clean.numbers["sigma_sdx_rad"], rel=0.2)
    (odd,) = (one for one in result.doubts if one.code == "points_odd")
    assert count - 1 <= odd.numbers["odd_count"] <= count + 4


def test_more_strays_than_neighbours_can_tell_are_refused(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    points = np.column_stack(list(table(folder).values()))
    strays = points.mean(axis=0) + np.random.default_rng(0).normal(0.0, 0.5, (450, 3))
    write_table_csv(folder / "points.csv", dict(zip(COLUMNS, np.concatenate([points, strays]).T, strict=True)))
    with pytest.raises(EstimationError, match="cut the points to the mirror"):
        measured(folder)


def test_a_shallow_mirror_from_behind_is_refused_by_the_name_of_the_key(tmp_path: Path) -> None:
    """Points in a frame whose origin is behind the mirror, and nobody said where the scanner stood."""
    scene = PointScene("paraboloid", (("focal_length_m", 50.0),), 2.0, 1.6, 900)
    folder = scanned(tmp_path / "scan", scene)
    measured(folder)
    columns = table(folder)
    columns["z_m"] -= 20.0
    write_table_csv(folder / "points.csv", columns)
    with pytest.raises(EstimationError, match="scanner_m"):
        measured(folder)


def test_rows_without_a_place_are_counted(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    columns = table(folder)
    columns["z_m"][[3, 8]] = np.nan
    write_table_csv(folder / "points.csv", columns)
    (doubt,) = (one for one in measured(folder).doubts if one.code == "points_without_place")
    assert doubt.numbers["points_count"] == 2


def test_true_slopes_stand_beside_the_scan(tmp_path: Path) -> None:
    """Slopes of the measured map against truth.csv by its nearest nodes, whose slopes differ by a step at most."""
    from scipy.spatial import cKDTree

    folder = scanned(tmp_path / "scan", TROUGH, points__x_axis=X_AXIS)
    _, true = read_columns_csv(folder / "truth.csv", (), ("x_m", "y_m", "slope_x", "slope_y"))
    one = measured(folder).slope_map
    x, y = (plane[one.valid] for plane in np.meshgrid(one.x_m, one.y_m))
    _, near = cKDTree(np.column_stack([true["x_m"], true["y_m"]])).query(np.column_stack([x, y]))
    # Half a step of 27 mm on a trough of 1.71 m, and the fitted place.
    assert np.abs(one.slope_x[one.valid] - true["slope_x"][near]).max() < 0.5 * 0.027 / 3.42 + 0.006


@pytest.mark.slow
@pytest.mark.parametrize("focal_length_m", [0.02, 0.1])
def test_a_design_of_another_mirror_is_refused(tmp_path: Path, focal_length_m: float) -> None:
    """No point is near it: nothing is left to place the mirror by."""
    folder = scanned(tmp_path / "scan", PointScene(), mirror__focal_length_m=focal_length_m)
    with pytest.raises(EstimationError, match=f"focal length {focal_length_m:g} m"):
        measured(folder)
