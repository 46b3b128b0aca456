"""Flux by the command: relative, by the power of the beam, by a calorimeter, on a target of uneven reflectance."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.beam.cli import app
from calibration.beam.files.flux_store import FluxStore
from calibration.beam.light.beam_image import measure_beam
from calibration.beam.light.flux_scale import Gauge, absolute_by_gauge, relative_flux
from tests.calibration.beam_pictures import CORNERS_M, gaussian, grid_m, picture, sky_light

WIDTHS, PLACE = (0.30, 0.22), (0.4, -0.3)
#: Of a Gaussian: its light over its peak [m^2].
AREA_M2 = 2 * np.pi * WIDTHS[0] * WIDTHS[1]
POWER_W = 5000.0


def at(x: float, y: float) -> float:
    """Flux of that Gaussian over its peak."""
    along = np.cos(0.6) * (x - PLACE[0]) + np.sin(0.6) * (y - PLACE[1])
    across = -np.sin(0.6) * (x - PLACE[0]) + np.cos(0.6) * (y - PLACE[1])
    return float(np.exp(-0.5 * ((along / WIDTHS[0]) ** 2 + (across / WIDTHS[1]) ** 2)))


def reflectance() -> np.ndarray:
    """Relative reflectance: it falls by a third from left to right."""
    x, _ = grid_m()
    return np.asarray(0.8 * (1 - 0.25 * x / 8 * 1.4))


def measured(folder: Path, flux: str, *, uneven: bool = False, second: bool = False) -> list[dict[str, str]]:
    folder.mkdir()
    rng = np.random.default_rng(3)
    painted = reflectance() / 0.8 if uneven else np.ones((224, 256))
    light = sky_light() + 120 * gaussian(PLACE, WIDTHS)
    cv2.imwrite(str(folder / "a.png"), np.rint(np.clip(light * painted + rng.normal(0, 1, light.shape), 0, 255)))
    if second:
        away = sky_light() + 120 * gaussian((-2.5, 1.5), WIDTHS)
        cv2.imwrite(str(folder / "b.png"), np.rint(np.clip(away + rng.normal(0, 1, light.shape), 0, 255)))
    cv2.imwrite(str(folder / "map.png"), np.rint(255 * reflectance()))
    (folder / "measurement.toml").write_text(
        'kind = "beam"\nname = "flux"\n[photos]\nphotos = ["a.png"' + (', "b.png"' if second else "") + "]\n"
        '[[target]]\nname = "white"\nwidth_m = 8.0\nheight_m = 7.0\n[[images]]\ntarget = "white"\nwhole = "edge"\n'
        + flux
    )
    out = folder.with_name(folder.name + "-out")
    done = CliRunner().invoke(app, ["measure", str(folder), "-o", str(out), "--no-report", "-q", "--jobs", "1"])
    if done.exit_code:
        raise ValueError(str(done.output) + str(done.exception))
    with (out / "beams.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def check(row: dict[str, str], unit: str, peak: float, power: float) -> None:
    assert row["flux_unit"] == unit
    for name, true in (("peak_flux", peak), ("power", power)):
        value, sigma = float(row[name]), float(row[f"sigma_{name}"])
        assert value == pytest.approx(true, abs=3 * sigma)
        assert sigma < 0.08 * true


def test_relative(tmp_path: Path) -> None:
    """A narrow beam: smoothing that finds its peak would lower it by 6 %."""
    check(measured(tmp_path / "m", "")[0], "1", 1.0, AREA_M2)


def test_by_power(tmp_path: Path) -> None:
    flux = f"[flux]\npower_w = {POWER_W}\nsigma_power_w = 50.0\n"
    check(measured(tmp_path / "m", flux)[0], "W/m2", POWER_W / AREA_M2, POWER_W)


def gauge(x: float, y: float, flux: float) -> str:
    return (
        f"[flux]\ngauge_flux_w_m2 = {flux:.2f}\nsigma_gauge_flux_w_m2 = {0.01 * flux:.2f}\n"
        f"gauge_center_m = [{x}, {y}]\ngauge_diameter_m = 0.15\n"
    )


def test_by_a_calorimeter_beside_the_peak(tmp_path: Path) -> None:
    peak = POWER_W / AREA_M2
    place = (PLACE[0] + 0.15, PLACE[1] + 0.1)
    rows = measured(tmp_path / "m", gauge(*place, peak * at(*place)), second=True)
    check(rows[0], "W/m2", peak, POWER_W)
    # The second beam is elsewhere: its flux is not known, and nothing else suffers.
    assert rows[1]["peak_flux"] in ("", "nan")
    assert float(rows[1]["x_m"]) == pytest.approx(-2.5, abs=0.05)


def test_a_calorimeter_that_no_beam_lights(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="none of 1 beams lights the calorimeter"):
        measured(tmp_path / "m", gauge(-3.0, 2.0, 1000.0))


def test_noise_of_a_pixel_is_not_the_sigma_of_the_peak() -> None:
    """Panels and the paraboloid's misfit grow with the peak; a pixel beside it, or a calorimeter there, has neither."""
    light = 120 * gaussian(PLACE, (0.9, 0.5))
    beam = measure_beam(picture(sky_light() + light, noise_dn=0.5))
    assert beam.light is not None
    scale, store = relative_flux(beam.size), FluxStore(CORNERS_M)
    store.add(0, beam.light)
    lit = cv2.resize(np.flipud(light), store.values_dn[0].shape[::-1], interpolation=cv2.INTER_AREA)
    scatter = float(np.sqrt(np.mean((store.values_dn[0] - lit)[lit > 10] ** 2)))
    assert np.hypot(scale.background_dn, scale.white_dn / np.sqrt(store.averaged[0])) == pytest.approx(scatter, rel=0.3)
    # Where 4 % of the peak are left the beam is bright enough for a scale of a few per cent.
    far = np.array(PLACE) + 0.9 * np.sqrt(-2 * np.log(0.04)) * np.array([np.cos(0.6), np.sin(0.6)])
    found = absolute_by_gauge(beam.size, beam.light, Gauge(40.0, 0.4, far, 0.3))
    assert found.sigma_share < 0.1
    assert found.of_beam[0] == pytest.approx(1000.0, abs=3 * found.of_beam[1])


def test_a_map_of_the_reflectance(tmp_path: Path) -> None:
    """A target that is a third darker on its right: with its map the beam stands and weighs as it does."""
    rows = [
        measured(tmp_path / name, flux, uneven=True)[0]
        for name, flux in (("without", ""), ("with", '[flux]\nreflectance_map = "map.png"\n'))
    ]
    check(rows[1], "1", 1.0, AREA_M2)
    x = [float(row["x_m"]) - PLACE[0] for row in rows]
    assert abs(x[1]) < 3 * float(rows[1]["sigma_x_m"])
    # Without it the centre moves by variance times the slope of the reflectance, 3 mm.
    assert x[0] - x[1] == pytest.approx(-0.0035, abs=0.0015)
