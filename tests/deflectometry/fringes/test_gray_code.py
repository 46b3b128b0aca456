"""Gray codes: cells of the display as OpenCV draws them, and as far as a camera resolves them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from data_synth.fringes import DatasetOptions, Knowledge, preset_scene, read_truth, write_gray_code
from deflectometry import load_deflectometry, run
from deflectometry.fringes.gray_code import GrayCodeObservation, decode, doubt_of_cells, estimate_noise
from deflectometry.setup.patterns import Axis, GrayCode
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.doubts import Severity
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.measurement.load import parse_measurement
from heliogauge.running import cli
from heliogauge.slopes.map import CELLS, CommonModes, SlopeMap
from heliogauge.slopes.statistics import fit_quadratic, statistics


def leave(*arguments: str) -> int:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    return int(caught.value.code or 0)


def shown(width: int, height: int) -> np.ndarray:
    """Frames as OpenCV draws them: a route of its own."""
    if not hasattr(cv2, "structured_light"):
        pytest.skip("this build of OpenCV has no contributed modules")
    _, frames = cv2.structured_light.GrayCodePattern.create(width, height).generate()
    return np.array(frames)


@pytest.mark.parametrize(("width", "height"), [(64, 32), (37, 21), (100, 2)])
def test_cells_are_those_that_opencv_draws(width: int, height: int) -> None:
    frames, code = shown(width, height), GrayCode(width, height)
    assert len(frames) == code.n_frames
    region = np.ones((height, width), dtype=bool)
    for axis, cells, index in ((Axis.X, width, 1), (Axis.Y, height, 0)):
        place, sigma, _ = decode(frames, code, axis, region, NoiseModel(1.0))
        expected = (np.indices((height, width))[index] + 0.5) / cells
        np.testing.assert_allclose(place.reshape(height, width), expected, atol=1e-9)
        np.testing.assert_allclose(sigma, 1 / cells / np.sqrt(12), rtol=1e-6)


def test_a_doubtful_bit_costs_what_the_finer_ones_leave_open() -> None:
    code = GrayCode(64, 2)
    frames = shown(64, 2)[:, :1, :].astype(np.float64)
    # Column 31 and 32 lie at the edge of the coarsest stripe: their first bit is lost, as is that of column 8.
    for column in (8, 31, 32):
        frames[:2, 0, column] = 127.5
    place, sigma, _ = decode(frames, code, Axis.X, np.ones((1, 64), dtype=bool), NoiseModel(1.0))
    cell = 1 / 64
    assert place[[8, 31, 32]] == pytest.approx(0.5)
    assert sigma[[31, 32]] == pytest.approx(np.sqrt(0.5**2 + 1 / 12) * cell)
    assert sigma[8] == pytest.approx(np.sqrt(23.5**2 + 1 / 12) * cell)
    assert np.delete(sigma, [8, 31, 32]) == pytest.approx(cell / np.sqrt(12))


def test_stripes_too_fine_for_the_lens_are_left_out() -> None:
    """Of stripes 2, 4, 8 ... columns wide a blur of 3 columns leaves those from 32 on, of 16 columns a cell."""
    code, frames = GrayCode(256, 2), shown(256, 2)[:, :1].astype(np.float32)
    blurred = np.stack([cv2.GaussianBlur(np.repeat(one, 9, axis=0), (0, 0), 3.0)[4:5] for one in frames])
    place, sigma, _ = decode(blurred, code, Axis.X, np.ones((1, 256), dtype=bool), NoiseModel(0.5))
    off = place - (np.arange(256) + 0.5) / 256
    usual = np.median(sigma)
    assert usual * np.sqrt(12) * 256 == pytest.approx(16, rel=0.01)
    # A uniform distribution ends at sqrt(3) of its sigma.
    assert np.abs(off / sigma).max() < 1.8


def test_noise_follows_from_frames_and_their_inverse() -> None:
    code = GrayCode(64, 32)
    rng = np.random.default_rng(1)
    frames = np.clip(shown(64, 32) * 0.7 + 20, 0, 255) + 2.0 * rng.standard_normal((code.n_frames, 32, 64))
    region = np.ones((32, 64), dtype=bool)
    assert estimate_noise(frames, code, region).sigma_read_dn == pytest.approx(2.0, rel=0.03)
    # Without light there is nothing but noise.
    frames[:, :, :10] = 20 + 2.0 * rng.standard_normal((code.n_frames, 32, 10))
    found = GrayCodeObservation(frames, code).screen_map(region)
    assert ((found.flags[:, :10] & SampleFlag.LOW_MODULATION) != 0).all()
    assert (found.flags[:, 10:] == 0).all()
    assert np.isnan(found.u[:, :10]).all()


@pytest.mark.slow
def test_slopes_of_a_drawn_facet(tmp_path) -> None:
    folder = tmp_path / "in"
    write_gray_code(folder, preset_scene("small"), 1920, 1080, DatasetOptions(0, Knowledge()))
    result, truth = run(load_deflectometry(folder)), read_truth(folder)
    found = result.evaluation.screen_map
    good = found.flags == 0
    assert good.sum() > 0.9 * np.count_nonzero(truth.pixels.facet_index >= 0)
    for place, sigma, exact in ((found.u, found.sigma_u, truth.pixels.u), (found.v, found.sigma_v, truth.pixels.v)):
        pull = ((place - exact) / sigma)[good]
        assert np.std(pull) == pytest.approx(1.0, abs=0.05)
        assert np.abs(pull).max() < 1.8
    assert "gray_code_cells" in {doubt.code for doubt in result.doubts}
    assert leave("deflectometry", "measure", str(folder), "-o", str(tmp_path / "out")) == 0
    assert leave("check", str(folder)) == 0
    assert leave("deflectometry", "plan", str(folder), "-o", str(tmp_path / "plan")) == 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (2560, 1440), (1280, 720), (300, 170)])
def test_sigmas_are_the_scatter_whatever_the_display(tmp_path, width: int, height: int, seed: int) -> None:
    """Cells and pixels beat: errors of neighbours are not independent, and no wrong set-up."""
    write_gray_code(tmp_path, preset_scene("small"), width, height, DatasetOptions(seed, Knowledge()))
    result, truth = run(load_deflectometry(tmp_path)), read_truth(tmp_path)
    assert {doubt.code for doubt in result.doubts if doubt.severity is not Severity.NOTE} == {"gray_code_cells"}
    found = result.assembled_as_measured
    fit = fit_quadratic(found)
    # Curvatures of the facet as fringes of all periods give them to 5e-6: 2.7695e-3, 2.1849e-3, twist 2.97e-4.
    exact = np.array([2.7695e-3, 2.1849e-3, 2.970e-4])
    sigma = np.sqrt(np.diag(fit.covariance))[[0, 1, 4]]
    assert np.abs((fit.coefficients[[0, 1, 4]] - exact) / sigma).max() < 3
    # The sigmas say something: focal lengths are known to a twentieth.
    assert (sigma / exact)[:2].max() < 0.05
    errors = truth.slope_errors(*np.meshgrid(found.x_m, found.y_m))
    for axis, error in zip("xy", errors, strict=True):
        true = float(np.sqrt(np.mean(error[found.valid] ** 2)))
        sd, sigma_sd = result.numbers[f"sd{axis}_rad"], result.numbers[f"sigma_sd{axis}_rad"]
        assert 0 < sd - true < 3 * sigma_sd
        assert sigma_sd < 0.7 * sd


def test_errors_of_cells_that_sd_contains_are_part_of_its_sigma() -> None:
    x_m = np.linspace(-1, 1, 41)
    slopes = np.random.default_rng(0).normal(0, 1e-3, (2, 41, 41))
    flat, sigma = np.zeros((41, 41)), np.full((41, 41), 0.6e-3)
    common = CommonModes((CELLS,), np.zeros((1, 2, 10)), np.zeros(2), 1.0)
    one = SlopeMap(
        x_m=x_m,
        y_m=x_m,
        slope_x=slopes[0],
        slope_y=slopes[1],
        design_slope_x=flat,
        design_slope_y=flat,
        sigma_random_x=sigma,
        sigma_random_y=sigma,
        flags=np.zeros((41, 41), dtype=np.uint32),
        height_m=flat,
        noise_correlation=1.0,
        common=common,
        aperture=np.ones((41, 41), dtype=bool),
        design="flat",
        frame="facet",
        removed="nothing",
    )
    # Of 1 mrad 0.6 are of the cells: 0.8 mrad are left.
    assert statistics(one).sigma_sdx_rad == pytest.approx(0.2e-3, rel=0.1)
    bare = replace(one, common=replace(common, sources=("camera",)))
    assert statistics(bare).sigma_sdx_rad < 0.03e-3


def test_cells_are_a_doubt_from_half_of_sd_on() -> None:
    def numbers(share: float) -> dict[str, float]:
        random = np.sqrt(share) * 1e-3
        sd = {"sdx_tilt_removed_rad": 1e-3, "sdy_tilt_removed_rad": 1e-3}
        return sd | {"sigma_random_x_rms_rad": random, "sigma_random_y_rms_rad": 0.1 * random}

    assert doubt_of_cells(numbers(0.45)) is None
    doubt = doubt_of_cells(numbers(0.55))
    assert doubt is not None
    assert doubt.code == "gray_code_cells"


def test_a_pattern_is_fringes_or_a_gray_code(tmp_path) -> None:
    write_content = {"kind": "deflectometry", "name": "x", "pattern": {}}
    with pytest.raises(InputError, match=r"pattern.gray_code"):
        parse_measurement(write_content, tmp_path / "measurement.toml")
