"""Sequences with a fault are mended: each fault alone is found with its size, and good frames are left as they are."""

import numpy as np
import pytest
from scipy import ndimage

from calibration.screen import ScreenResponse
from deflectometry.frames.frame_model import Oddity, OddityKind, estimate_frames
from deflectometry.frames.light_checks import FaultKind
from deflectometry.frames.repair import repair_frames
from deflectometry.setup.patterns import Axis, FringePattern, make_pattern
from deflectometry.sources.noise_model import NoiseModel
from tests.deflectometry.fringe_drawing import Scene

PATTERN = make_pattern([0.9, 3.9, 15.9, 63.9], [0.9, 3.9, 15.9, 63.9])
NOISE = NoiseModel(1.0)


@pytest.fixture(scope="module")
def readings() -> np.ndarray:
    return Scene().readings(PATTERN, np.random.default_rng(1))


def _found(readings: np.ndarray, pattern: FringePattern = PATTERN) -> tuple[Oddity, ...]:
    model = estimate_frames(np.rint(readings).astype(np.uint8), pattern, NOISE, saturation_dn=255)
    assert model is not None
    return model.oddities


def _close(found: Oddity, value: float) -> bool:
    return bool(abs(found.value[0] - value) < 4 * found.sigma[0])


@pytest.mark.parametrize(("steps", "gamma"), [(3, 1.0), (3, 1.4), (4, 1.0), (4, 2.2), (8, 1.4), (8, 2.2)])
def test_good_frames_and_a_gamma_are_nothing_odd(steps: int, gamma: float) -> None:
    pattern = make_pattern([0.9, 3.9, 15.9], [0.9, 3.9, 15.9], steps)
    assert _found(Scene(gamma=gamma).readings(pattern, np.random.default_rng(2)), pattern) == ()


@pytest.mark.parametrize(("frame", "offset_dn"), [(14, -6.0), (29, 3.0)])
def test_offset_of_a_frame(readings: np.ndarray, frame: int, offset_dn: float) -> None:
    readings = readings.copy()
    readings[frame] += offset_dn
    (found,) = _found(readings)
    assert (found.kind, found.frames) == (OddityKind.OFFSET, (frame,))
    assert _close(found, offset_dn)


def test_drift(readings: np.ndarray) -> None:
    (found,) = _found(readings * np.linspace(1, 0.95, 32)[:, None, None])
    assert found.kind is OddityKind.DRIFT
    assert _close(found, -0.05)


@pytest.mark.parametrize("rise_dn", [0.32, -0.32, 0.9])
def test_light_of_the_room_that_rises_or_falls(readings: np.ndarray, rise_dn: float) -> None:
    """Counted as a share of all light it left 0.7 % in the frames, and steps that no display shows."""
    (found,) = _found(readings + rise_dn * np.arange(32)[:, None, None])
    assert found.kind is OddityKind.AMBIENT
    assert _close(found, 31 * rise_dn)
    mended = repair_frames(
        np.rint(readings + rise_dn * np.arange(32)[:, None, None]).astype(np.uint8), PATTERN, saturation_dn=255
    )
    assert not mended.errors
    assert [one.code for one in mended.repairs] == ["frame_light_corrected"]
    assert "light beside the fringes drifts" in mended.repairs[0].text
    left = mended.frames - readings
    assert np.abs(left.mean(axis=(1, 2)) - left.mean()).max() < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_drift_and_flicker_together_are_solved(readings: np.ndarray, seed: int) -> None:
    """Flicker of every frame holds the drift: equations of both were singular."""
    share = np.random.default_rng(seed).uniform(-0.015, 0.015, 32)
    found = _found(readings * (np.linspace(1, 0.93, 32) + share)[:, None, None])
    assert {one.kind for one in found} <= {OddityKind.DRIFT, OddityKind.FLICKER, OddityKind.GAIN}
    assert found


def test_flicker_of_every_frame_is_found_in_all_together(readings: np.ndarray) -> None:
    """No single frame does half as much as noise; off axis, the focus was 7.6 sigma off."""
    share = np.random.default_rng(7).uniform(-0.015, 0.015, 32)
    (found,) = _found(readings * (1 + share)[:, None, None])
    assert (found.kind, found.frames) == (OddityKind.FLICKER, tuple(range(32)))
    off = (found.value - (share[1:] - share[0])) / found.sigma
    assert np.sqrt(np.mean(off**2)) < 2
    assert found.sigma.max() < 0.015


def test_moved_frames(readings: np.ndarray) -> None:
    readings = readings.copy()
    for k in (13,):
        readings[k] = ndimage.shift(readings[k], (0.3, 0.5), order=5, mode="nearest")
    kinds = {one.kind for one in _found(readings)}
    assert kinds & {OddityKind.SHIFT, OddityKind.CONTRAST}


def test_a_camera_that_was_knocked_between_two_sets(readings: np.ndarray) -> None:
    # The mirror fills the middle, so that its edges are seen; drawn as steps, which no shift of light follows exactly.
    scene = Scene(cover=0.5)
    frames = scene.readings(PATTERN, np.random.default_rng(3))
    for k in range(20, 32):
        frames[k] = ndimage.shift(frames[k], (-0.3, 0.5), order=3, mode="nearest")
    repaired = repair_frames(np.clip(np.rint(frames), 0, 255).astype(np.uint8), PATTERN)
    assert not repaired.errors
    (moved,) = [doubt for doubt in repaired.repairs if doubt.code == "frames_moved"]
    assert moved.numbers["shift_x_px"] == pytest.approx(0.5, abs=0.05)
    assert moved.numbers["shift_y_px"] == pytest.approx(-0.3, abs=0.05)


def _declared(change: float, index: int) -> FringePattern:
    sets = list(PATTERN.sets)
    one = sets[index]
    sets[index] = type(one)(one.axis, one.periods * (1 + change), one.steps_rad)
    return FringePattern(tuple(sets))


@pytest.mark.parametrize("index", [3, 6, 7])
def test_periods_of_one_set(readings: np.ndarray, index: int) -> None:
    frames = np.rint(readings).astype(np.uint8)
    repaired = repair_frames(frames, _declared(0.0016, index))
    assert not repaired.errors
    assert [doubt.code for doubt in repaired.repairs] == ["fringe_periods_corrected"]
    # The scale of the finest fringes is that of the others then, and as uncertain.
    sigma = max(float(repaired.sigma_periods.max()), 1e-4)
    assert abs(repaired.pattern.sets[index].periods / PATTERN.sets[index].periods - 1) < 4 * sigma
    assert (repaired.sigma_periods > 0).tolist() == [index == 7, index == 3]


def test_periods_of_a_coarse_set_are_not_blamed_on_the_finest(readings: np.ndarray) -> None:
    """The finest set explains them nearly as well, and moves the result."""
    (found,) = _found(readings, _declared(0.001, 2))
    assert (found.kind, found.frames) == (OddityKind.SCALE_OF_SET, (8, 9, 10, 11))
    assert _close(found, 1 / 1.001 - 1)


def test_good_frames_stay_the_very_same(readings: np.ndarray) -> None:
    frames = np.rint(readings).astype(np.uint8)
    repaired = repair_frames(frames, PATTERN)
    assert repaired.frames is frames
    assert repaired.pattern is PATTERN
    assert repaired.repairs == repaired.faults == ()


def test_a_set_that_is_not_resolved_is_left_out(readings: np.ndarray) -> None:
    readings = readings.copy()
    rng = np.random.default_rng(6)
    readings[28:] = 110 + rng.standard_normal(readings[28:].shape)
    repaired = repair_frames(np.rint(readings).astype(np.uint8), PATTERN)
    assert not repaired.errors
    assert [doubt.code for doubt in repaired.repairs] == ["fringes_unresolved"]
    assert len(repaired.pattern.sets_of(Axis.X)) == 3


def test_lost_axis_is_refused(readings: np.ndarray) -> None:
    readings = readings.copy()
    readings[16:] = 110 + np.random.default_rng(6).standard_normal(readings[16:].shape)
    repaired = repair_frames(np.rint(readings).astype(np.uint8), PATTERN)
    assert repaired.errors
    assert repaired.repairs == ()


def test_all_late_and_permuted_frames_are_put_in_order(readings: np.ndarray) -> None:
    frames = np.rint(readings).astype(np.uint8)
    repaired = repair_frames(np.roll(frames, 1, axis=0), PATTERN)
    assert [doubt.code for doubt in repaired.repairs] == ["frames_reordered"]
    assert (repaired.frames == frames).all()
    order = np.arange(32)
    order[[4, 9, 30]] = [9, 30, 4]
    repaired = repair_frames(frames[order], PATTERN)
    assert [doubt.code for doubt in repaired.repairs] == ["frames_reordered"]
    assert (repaired.frames == frames).all()


@pytest.mark.parametrize("frame", [10, 26])
def test_one_moved_frame_is_moved_back_and_not_its_set(frame: int) -> None:
    frames = Scene(cover=0.5, noise_dn=2.0).readings(PATTERN, np.random.default_rng(3))
    # Edges as a lens draws them.
    frames = np.stack([ndimage.gaussian_filter(one, 0.7) for one in frames])
    frames[frame] = ndimage.shift(frames[frame], (-0.2, 0.7), order=5, mode="nearest")
    repaired = repair_frames(np.clip(np.rint(frames), 0, 255).astype(np.uint8), PATTERN)
    assert not repaired.errors
    (moved,) = [doubt for doubt in repaired.repairs if doubt.code == "frames_moved"]
    assert moved.text.startswith(f"frame {frame} ")
    assert moved.numbers["shift_x_px"] == pytest.approx(0.7, abs=0.05)
    assert moved.numbers["shift_y_px"] == pytest.approx(-0.2, abs=0.05)


@pytest.mark.parametrize("gamma", [1.0, 1.6])
def test_a_blurred_frame_is_left_out_with_a_response_too(gamma: float) -> None:
    camera_dn = np.linspace(10, 220, 60)
    response = ScreenResponse(camera_dn, ((camera_dn - 10) / 210) ** (1 / gamma)) if gamma != 1 else None
    frames = Scene(offset_dn=115, gamma=gamma).readings(PATTERN, np.random.default_rng(3))
    frames[30] = ndimage.gaussian_filter(frames[30], 1.2)
    repaired = repair_frames(np.clip(np.rint(frames), 0, 255).astype(np.uint8), PATTERN, response=response)
    assert not repaired.errors
    (left,) = [doubt for doubt in repaired.repairs if doubt.code == "frames_left_out"]
    assert left.text.startswith("frame 30 ")
    assert repaired.pattern.n_frames == 31


@pytest.mark.slow
def test_so_many_kinds_of_faults_are_refused() -> None:
    frames = Scene(cover=0.5, noise_dn=2.0).readings(PATTERN, np.random.default_rng(3))
    frames = np.stack([ndimage.gaussian_filter(one, 0.7) for one in frames])
    # A knock, exchanged frames, a blurred one, light beside the fringes: each alone is mended.
    for k in range(24, 32):
        frames[k] = ndimage.shift(frames[k], (0.0, 0.6), order=3, mode="nearest")
    frames[[1, 2]] = frames[[2, 1]]
    frames[14] = ndimage.gaussian_filter(frames[14], 1.0)
    frames[18] += 12.0
    repaired = repair_frames(np.clip(np.rint(frames), 0, 255).astype(np.uint8), PATTERN)
    assert [fault.kind for fault in repaired.errors][:1] == [FaultKind.CASCADE]
    assert repaired.repairs == ()
