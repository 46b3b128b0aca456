"""From frames to display points: honest sigmas, the edges, every flag, layouts, and a published measurement."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from calibration.screen import ScreenResponse
from deflectometry.frames.sequence_checks import FaultKind, check_frames
from deflectometry.fringes.screen_map import ScreenMapLimits, measure_screen_map, modulation_image
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet, equal_steps, make_pattern
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from tests.deflectometry.fringe_drawing import Scene
from tests.deflectometry.one_pixel import fit_phase, unwrap_temporal

PERIODS = [0.9, 3.9, 15.9, 63.9]
PATTERN = make_pattern(PERIODS, PERIODS)


def _errors(found: ScreenMap, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    u, v = scene.positions()
    return found.u - u, found.v - v


def _has(found: ScreenMap, flag: SampleFlag) -> np.ndarray:
    return (found.flags & np.uint32(flag)) != 0


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_sigmas_are_honest(steps: int) -> None:
    scene, rng = Scene(shape=(200, 300)), np.random.default_rng(steps)
    pattern = make_pattern([0.9, 3.9, 15.9], [0.9, 3.9, 15.9], steps=steps)
    noise = NoiseModel(np.sqrt(1 + 1 / 12)) if steps == 3 else None
    found = measure_screen_map(scene.frames(pattern, rng), pattern, noise=noise)
    for error, sigma in zip(_errors(found, scene), (found.sigma_u, found.sigma_v), strict=True):
        valid = np.isfinite(error)
        assert valid.mean() > 0.9999
        # 60 000 samples: 99 % within 1.5 %; the estimated noise adds 0.3 %.
        assert np.mean((error[valid] / sigma[valid]) ** 2) == pytest.approx(1.0, abs=0.02)
    assert not found.systematic_phase_rad.any()


def test_blocks_agree_with_the_plain_functions() -> None:
    scene, rng = Scene(shape=(30, 40), gain_dn=0.02), np.random.default_rng(1)
    steps = np.radians([0.0, 61.0, 150.0, 170.0, 291.0])
    pattern = FringePattern(tuple(FringeSet(axis, p, steps) for axis in Axis for p in (7.0, 0.9, 2.6)))
    frames = scene.frames(pattern, rng)
    noise = NoiseModel(1.0, 0.02)
    found = measure_screen_map(frames, pattern, noise=noise)
    for axis, position, sigma in ((Axis.X, found.u, found.sigma_u), (Axis.Y, found.v, found.sigma_v)):
        sets = pattern.sets_of(axis)
        fits = [fit_phase(frames[place], fringes.steps_rad, noise=noise) for fringes, place in sets]
        plain = unwrap_temporal(
            [fit.phase_rad for fit in fits], [fit.sigma_rad for fit in fits], [fringes.periods for fringes, _ in sets]
        )
        np.testing.assert_allclose(position, plain.fraction, atol=1e-6)
        np.testing.assert_allclose(sigma, plain.sigma, rtol=1e-4)


@pytest.mark.parametrize("coarsest", [0.9, 1.0, 1.4])
def test_no_unflagged_gross_error_at_the_edges_of_the_display(coarsest: float) -> None:
    pattern = make_pattern([coarsest, 4 * coarsest, 16 * coarsest], [coarsest, 4 * coarsest, 16 * coarsest])
    rng = np.random.default_rng(2)
    gross = jumps = flagged = 0
    for start in (0.0, 0.998):  # the first and the last 0.2 %
        u = np.linspace(start, start + 0.002, 40_000).reshape(200, 200)
        frames = np.stack(
            [
                100 + 80 * np.cos(2 * np.pi * fringes.periods * u - step) + rng.standard_normal(u.shape)
                for fringes in pattern.sets
                for step in fringes.steps_rad
            ]
        )
        found = measure_screen_map(np.rint(frames).astype(np.uint8), pattern)
        for position in (found.u, found.v):
            jumps += np.count_nonzero(np.abs(position - u) > 0.5)
            gross += np.count_nonzero(np.abs(position - u) > 0.5 / pattern.sets[0].periods / 16)
        flagged += np.count_nonzero(_has(found, SampleFlag.FRINGE_ORDER_UNCERTAIN))
    assert (gross, jumps) == (0, 0)
    if coarsest == 0.9:
        assert flagged == 0  # the dead band resolves the edge: nothing is lost there
    if coarsest == 1.0:
        assert flagged > 0  # whole periods do not: 0 and 1 look the same


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("transposed", [False, True], ids=["n h w", "h w n"])
def test_types_and_layouts_give_the_same(dtype: type, transposed: bool) -> None:
    frames = Scene(shape=(20, 30)).frames(PATTERN, np.random.default_rng(3))
    expected = measure_screen_map(frames, PATTERN)
    other = frames.astype(dtype)
    if transposed:
        other = np.ascontiguousarray(other.transpose(1, 2, 0)).transpose(2, 0, 1)
    found = measure_screen_map(other, PATTERN, noise=expected.noise)
    np.testing.assert_allclose(found.u, expected.u, atol=1e-6)
    np.testing.assert_allclose(found.sigma_v, expected.sigma_v, rtol=1e-4)
    assert np.array_equal(found.flags, expected.flags)


def test_region_is_measured_alone() -> None:
    scene, rng = Scene(shape=(60, 80), cover=0.3), np.random.default_rng(4)
    frames, region = scene.frames(PATTERN, rng), scene.mirror()
    found = measure_screen_map(frames, PATTERN, region=region)
    assert np.array_equal(_has(found, SampleFlag.OUTSIDE_MIRROR), ~region)
    assert np.array_equal(np.isfinite(found.u), region)
    whole = measure_screen_map(frames, PATTERN, noise=found.noise)
    np.testing.assert_allclose(found.u[region], whole.u[region], atol=1e-6)
    assert _has(whole, SampleFlag.LOW_MODULATION)[~region].all()  # background: named for what it is
    assert np.isnan(whole.u[~region]).all()


def test_pixels_without_fringes_pass_as_rarely_as_stated() -> None:
    rng = np.random.default_rng(5)
    frames = np.rint(60 + rng.standard_normal((32, 300, 400))).astype(np.uint8)
    limits = ScreenMapLimits(no_fringe_probability=1e-2)
    found = measure_screen_map(frames, PATTERN, noise=NoiseModel(np.sqrt(1 + 1 / 12)), limits=limits)
    passed = ~_has(found, SampleFlag.LOW_MODULATION)
    # Both axes' coarsest sets must pass by chance: 1e-4 of 120 000 pixels.
    assert 2 <= np.count_nonzero(passed) <= 30


def test_false_alarms_of_disagreeing_frames_are_as_rare_as_stated() -> None:
    scene = Scene(shape=(200, 300))
    limits = ScreenMapLimits(disagree_probability=1e-2)
    found = measure_screen_map(scene.frames(PATTERN, np.random.default_rng(6)), PATTERN, limits=limits)
    assert _has(found, SampleFlag.FRAMES_DISAGREE).mean() == pytest.approx(0.01, abs=0.003)


def test_each_fault_of_a_pixel_has_its_flag() -> None:
    scene = Scene(shape=(60, 80))
    frames = scene.frames(PATTERN, np.random.default_rng(7)).astype(np.float32)
    frames[5, 10, 10] = 255
    frames[9, 20, 20] += 30
    frames[3, 30, 30] = np.nan
    frames[:, 40, 40] = frames[:, 40, 40].mean()
    found = measure_screen_map(frames, PATTERN, limits=ScreenMapLimits(saturation_dn=255))
    expected = {
        (10, 10): SampleFlag.SATURATED,
        (20, 20): SampleFlag.FRAMES_DISAGREE,
        (30, 30): SampleFlag.INPUT_NOT_FINITE,
        (40, 40): SampleFlag.LOW_MODULATION,
    }
    for pixel, flag in expected.items():
        assert found.flags[pixel] & np.uint32(flag), flag
        assert np.isnan(found.u[pixel])
    found.flags.setflags(write=True)
    for pixel in expected:
        found.flags[pixel] = 0
    assert not found.flags.any()


def test_positions_beyond_the_display_are_flagged() -> None:
    scene = Scene(shape=(40, 200), margin=-0.03)
    found = measure_screen_map(scene.frames(PATTERN, np.random.default_rng(8)), PATTERN)
    u, v = scene.positions()
    beyond = (abs(u - 0.5) > 0.5005) | (abs(v - 0.5) > 0.5005)
    inside = (abs(u - 0.5) < 0.4995) & (abs(v - 0.5) < 0.4995)
    assert _has(found, SampleFlag.OFF_SCREEN)[beyond].all()
    assert not _has(found, SampleFlag.OFF_SCREEN)[inside].any()


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_response_straightens_gamma(dtype: type) -> None:
    scene, rng = Scene(shape=(100, 150), gamma=1.8), np.random.default_rng(9)
    frames = scene.frames(PATTERN, rng).astype(dtype)
    level = np.linspace(0, 1, 200)
    response = ScreenResponse(20 + 180 * level**1.8, 200 * level)
    straight = measure_screen_map(frames, PATTERN, response=response)
    error, _ = _errors(straight, scene)
    valid = np.isfinite(error)
    assert valid.mean() > 0.99
    # Readings held at the ends of the look-up are not linear any more: the band is wider than for plain noise.
    assert np.mean((error / straight.sigma_u)[valid] ** 2) == pytest.approx(1.0, abs=0.15)


def test_systematic_phase_makes_sigmas_honest_for_a_gamma_without_response() -> None:
    scene, rng = Scene(shape=(100, 150), gamma=2.2, noise_dn=0.5), np.random.default_rng(10)
    pattern = make_pattern([0.9, 2.7, 8.1], [0.9, 2.7, 8.1], steps=3)
    found = measure_screen_map(scene.frames(pattern, rng), pattern, noise=NoiseModel(0.6))
    error, _ = _errors(found, scene)
    valid = np.isfinite(error)
    assert valid.mean() > 0.99
    assert found.systematic_phase_rad.min() > 0.1
    assert np.abs(error[valid]).max() < 0.02
    assert 0.5 < np.mean((error / found.sigma_u)[valid] ** 2) < 2  # from noise alone: above 100


def test_modulation_image_shows_the_mirror_before_anything_is_known() -> None:
    scene = Scene(shape=(60, 80), cover=0.3)
    image = modulation_image(scene.frames(PATTERN, np.random.default_rng(11)), PATTERN)
    mirror = scene.mirror()
    assert image[mirror].mean() == pytest.approx(90, abs=1)
    assert image[~mirror].max() < 5


def test_impossible_input_is_refused() -> None:
    frames = np.zeros((32, 4, 5), dtype=np.uint8)
    with pytest.raises(InputError, match="32 frames"):
        measure_screen_map(frames[:31], PATTERN)
    with pytest.raises(InputError, match="shape"):
        measure_screen_map(frames[0], PATTERN)
    with pytest.raises(InputError, match="region"):
        measure_screen_map(frames, PATTERN, region=np.ones((5, 4), dtype=bool))
    with pytest.raises(EstimationError, match="in view"):
        measure_screen_map(frames, PATTERN, region=np.zeros((4, 5), dtype=bool))
    three = make_pattern([0.9], [0.9], steps=3)
    with pytest.raises(EstimationError, match="pixel_noise_dn"):
        measure_screen_map(np.zeros((6, 4, 5)), three)
    with pytest.raises(InputError, match="probability"):
        ScreenMapLimits(wrong_order_probability=0)
    assert _has(measure_screen_map(frames, PATTERN), SampleFlag.LOW_MODULATION).all()


@pytest.fixture(scope="module")
def published(shared_data: Path) -> dict[str, np.ndarray]:
    """Frames of a facet, and what the program that came with them made of them."""
    folder = shared_data / "opencsp" / "fringe"
    if not folder.is_dir():
        pytest.skip("the published fringe measurement is not on this machine")
    with h5py.File(folder / "measurement_facet.h5") as file:
        frames = file["MeasurementSofastFringe/fringe_images"][()].transpose(2, 0, 1)
    with h5py.File(folder / "image_calibration.h5") as file:
        camera, display = (file[f"ImageCalibration/{name}_values"][()] for name in ("camera", "display"))
    with h5py.File(folder / "expected_facet" / "data.h5") as file:
        part = file["DataSofastCalculation/facet/facet_000"]
        fractions = part["CalculationDataGeometryFacet/v_screen_points_fractional_screens"][()]
        mask = part["CalculationImageProcessingFacet/mask_processed"][()]
    return {"frames": frames, "camera": camera, "display": display, "fractions": fractions, "mask": mask}


def test_finest_set_alone_reproduces_the_published_fractions(published: dict[str, np.ndarray]) -> None:
    response = ScreenResponse(published["camera"], published["display"])
    readings = published["frames"][:, published["mask"]]
    for axis, expected in ((Axis.X, published["fractions"][0]), (Axis.Y, 1 - published["fractions"][1])):
        fits = [
            fit_phase(readings[place], equal_steps(4), noise=NoiseModel(1.0), response=response)
            for _, place in PATTERN.sets_of(axis)
        ]
        all_sets = unwrap_temporal([fit.phase_rad for fit in fits], [fit.sigma_rad for fit in fits], PERIODS)
        turns = fits[-1].phase_rad / (2 * np.pi)
        finest = (np.rint(PERIODS[-1] * all_sets.fraction - turns) + turns) / PERIODS[-1]
        np.testing.assert_allclose(finest, expected, atol=2e-7)  # they keep float32


@pytest.mark.parametrize("linearised", [True, False])
def test_published_measurement(published: dict[str, np.ndarray], linearised: bool) -> None:
    response = ScreenResponse(published["camera"], published["display"]) if linearised else None
    mask = published["mask"]
    found = measure_screen_map(published["frames"], PATTERN, response=response, region=mask)
    assert not found.flags[mask].any()
    for position, expected in ((found.u, published["fractions"][0]), (found.v, 1 - published["fractions"][1])):
        difference = position[mask] - expected
        # The published position is the finest set's alone; ours weighs all, which matters where its contrast is low.
        assert np.sqrt(np.mean(difference**2)) < 5e-5
        assert np.abs(difference).max() < 6e-4


def test_published_response_is_recognised_as_not_belonging(published: dict[str, np.ndarray]) -> None:
    response = ScreenResponse(published["camera"], published["display"])
    assert not check_frames(published["frames"], PATTERN)
    kinds = {fault.kind for fault in check_frames(published["frames"], PATTERN, response=response)}
    assert FaultKind.RESPONSE in kinds
