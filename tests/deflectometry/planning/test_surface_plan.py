"""Plans of scans of the surface: promised sigmas against those that are then stated, and against true errors."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from deflectometry.cli import app
from deflectometry.scans.keys import SurfaceScanModel, load_surface_scan
from deflectometry.scans.pipeline.measure import run
from deflectometry.scans.planning.plan import PlannedSurfaceScan
from heliogauge.errors import InputError
from heliogauge.measurement.load import read_measurement
from heliogauge.results.folder import read_summary

FOCAL_M, SIDE_M, COUNT = 20.0, (2.0, 1.5), (44, 33)
#: Egg-box waves: slopes of this RMS in each direction, this length.
WAVE_RAD, LENGTH_M = 0.5e-3, 0.8
TOML = f"""
kind = "surface-scan"
name = "facet"
[points]
file = "points.csv"
sigma_point_mm = 0.05
x_axis = [1.0, 0.0, 0.0]
scanner_m = [0.0, 0.0, 5.0]
[mirror]
design = "paraboloid"
focal_length_m = {FOCAL_M}
[plan]
width_m = {SIDE_M[0]}
height_m = {SIDE_M[1]}
columns = {COUNT[0]}
rows = {COUNT[1]}
wave_mrad = {1e3 * WAVE_RAD}
wave_length_m = {LENGTH_M}
"""


def waves(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return height and slopes of the egg box."""
    number = np.sqrt(2) * np.pi / LENGTH_M
    height = 2 * WAVE_RAD / number
    return (
        height * np.sin(number * x + 0.3) * np.sin(number * y + 1.1),
        height * number * np.cos(number * x + 0.3) * np.sin(number * y + 1.1),
        height * number * np.sin(number * x + 0.3) * np.cos(number * y + 1.1),
    )


def scanned(folder: Path, seed: int) -> Path:
    """Write a scan: by its own formulas, with noise."""
    rng = np.random.default_rng(seed)
    x, y = (
        one.ravel() for one in np.meshgrid(*(np.linspace(-0.5, 0.5, n) * s for n, s in zip(COUNT, SIDE_M, strict=True)))
    )
    points = np.stack([x, y, (x**2 + y**2) / (4 * FOCAL_M) + waves(x, y)[0]]) + 5e-5 * rng.standard_normal((3, x.size))
    folder.mkdir()
    (folder / "measurement.toml").write_text(TOML, encoding="utf-8")
    np.savetxt(folder / "points.csv", points.T, delimiter=",", header="x_m,y_m,z_m", comments="")
    return folder


def planned(folder: Path, changes: dict[str, Any] | None = None) -> PlannedSurfaceScan:
    content = read_measurement(folder, SurfaceScanModel)[1].model_dump(exclude_unset=True)
    for key, value in (changes or {}).items():
        table, name = key.split(".")
        content[table] = {k: v for k, v in (content[table] | {name: value}).items() if v is not None}
    return PlannedSurfaceScan(folder, SurfaceScanModel.model_validate(content))


@pytest.mark.slow
def test_what_is_promised_is_stated_and_holds_the_errors(tmp_path: Path) -> None:
    promised = planned(scanned(tmp_path / "0", 0)).prospect().sigmas()
    over: dict[str, list[float]] = {name: [] for name in ("x", "y")}
    for seed in range(1, 6):
        result = run(load_surface_scan(scanned(tmp_path / str(seed), seed)))
        one = result.slope_map
        x, y = np.meshgrid(one.x_m, one.y_m)
        for axis, slope, own in zip("xy", (one.slope_x, one.slope_y), waves(x, y)[1:], strict=True):
            stated = float(result.numbers[f"sigma_slope_{axis}_rms_rad"] or 0.0)
            # The plan's waves go in all directions, these along the diagonals: patches lose a third more of them.
            assert promised[f"slope_{axis}"] == pytest.approx(stated, rel=0.4)
            left = (slope - (x, y)["xy".index(axis)] / (2 * FOCAL_M) - own)[one.valid]
            # Where the mirror stands is fitted.
            over[axis].append(float(np.std(left)) / stated)
    for values in over.values():
        # What a patch could lose unseen is in the sigma, too.
        assert 0.5 < np.sqrt(np.mean(np.square(values))) < 1.15


def test_waves_and_points_count(tmp_path: Path) -> None:
    """Without waves large patches lose nothing; the plan says that it takes it so."""
    folder = scanned(tmp_path / "s", 0)
    few = {"plan.columns": 30, "plan.rows": 22}
    with_waves = planned(folder, few).prospect()
    none = {"plan.wave_mrad": None, "plan.wave_length_m": None}
    without = planned(folder, few | none).prospect()
    assert without.sigmas()["slope_x"] < 0.7 * with_waves.sigmas()["slope_x"]
    shares = [planned(folder, one).limits(two)["slope_x"] for one, two in ((few, with_waves), (few | none, without))]
    assert [sum(one.values()) for one in shares] == pytest.approx([1.0, 1.0])
    assert shares[0]["waves that patches lose"] > shares[1]["waves that patches lose"] > 0
    assert "plan_without_waves" in {one.code for one in without.doubts}
    assert "plan_without_waves" not in {one.code for one in with_waves.doubts}


def test_normals_are_worth_their_sigma(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "s", 0)
    found = planned(folder, {"points.slopes_from": "normals", "points.sigma_normal_mrad": 0.8}).prospect()
    assert found.numbers["sigma_random_x_rms_rad"] == pytest.approx(0.8e-3, rel=0.02)


def test_the_command_and_what_is_missing(tmp_path: Path) -> None:
    folder = scanned(tmp_path / "s", 0)
    small = TOML.replace(f"columns = {COUNT[0]}", "columns = 20").replace(f"rows = {COUNT[1]}", "rows = 15")
    (folder / "measurement.toml").write_text(small, encoding="utf-8")
    (folder / "points.csv").unlink()
    answer = CliRunner().invoke(app, ["plan", str(folder), "-o", str(tmp_path / "p"), "--no-report", "-q"])
    assert answer.exit_code == 0, answer.output
    assert read_summary(tmp_path / "p").numbers["samples_count"] == 300
    with pytest.raises(InputError, match=r"\[plan\] is missing"):
        PlannedSurfaceScan(folder, planned(folder).model.model_copy(update={"plan": None})).prospect()
    with pytest.raises(InputError, match="sigma_point_mm is missing"):
        planned(folder, {"points.sigma_point_mm": None}).prospect()
    with pytest.raises(InputError, match=r"\[plan\]: 99999999999 x 15 points need .* GiB of memory"):
        planned(folder, {"plan.columns": 99_999_999_999}).prospect()
    with pytest.raises(ValueError, match="given together"):
        planned(folder, {"plan.wave_mrad": None})
