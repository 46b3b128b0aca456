"""Frame checks: each fault is named with its frames and numbers; good frames raise no alarm."""

import re
from dataclasses import replace

import numpy as np
import pytest

from deflectometry.frames.frame_content import estimate_steps
from deflectometry.frames.sequence_checks import FaultKind, FrameFault, check_frames
from deflectometry.setup.patterns import FringePattern, equal_steps, make_pattern
from tests.deflectometry.fringe_drawing import Scene

PATTERNS = {
    3: make_pattern([0.9, 3.9, 15.9], [0.9, 3.9, 15.9], steps=3),
    4: make_pattern([0.9, 3.9, 15.9, 63.9], [0.9, 3.9, 15.9, 63.9], steps=4),
    16: make_pattern([0.9, 3.9, 15.9], [0.9, 3.9, 15.9], steps=16),
}
WHOLE = make_pattern([1, 4, 16], [1, 4, 16])


def _frames(pattern: FringePattern, seed: int = 1, **changed: float) -> np.ndarray:
    return Scene(**changed).frames(pattern, np.random.default_rng(seed))


def _only(faults: list[FrameFault]) -> FrameFault:
    assert len(faults) == 1, [fault.message for fault in faults]
    return faults[0]


@pytest.mark.parametrize("steps", [3, 4, 16])
@pytest.mark.parametrize("cover", [1.0, 0.2])
@pytest.mark.parametrize("noise_dn", [0.0, 1.0, 3.0])
def test_good_frames_raise_no_alarm(steps: int, cover: float, noise_dn: float) -> None:
    assert not check_frames(_frames(PATTERNS[steps], cover=cover, noise_dn=noise_dn), PATTERNS[steps])


@pytest.mark.parametrize("seed", range(5))
def test_good_frames_of_low_contrast_or_whole_periods(seed: int) -> None:
    assert not check_frames(_frames(PATTERNS[4], seed, noise_dn=2, modulation_dn=12, offset_dn=40), PATTERNS[4])
    assert not check_frames(_frames(WHOLE, seed), WHOLE)
    few = make_pattern([0.9, 6], [0.9, 6], steps=5)
    assert not check_frames(_frames(few, seed, margin=0.3), few)  # a third of the display in view


@pytest.mark.parametrize("steps", [3, 4, 16])
def test_repeated(steps: int) -> None:
    frames = _frames(PATTERNS[steps])
    frames[6] = frames[5]
    fault = _only(check_frames(frames, PATTERNS[steps]))
    assert (fault.kind, fault.frames, fault.severity) == (FaultKind.REPEATED, (5, 6), "error")


@pytest.mark.parametrize("steps", [3, 4, 16])
def test_stale(steps: int) -> None:
    frames = _frames(PATTERNS[steps])
    frames[7] = _frames(PATTERNS[steps], seed=2)[6]  # its own noise: not the same image twice
    fault = _only(check_frames(frames, PATTERNS[steps]))
    assert (fault.kind, fault.frames) == (FaultKind.STALE, (7,))
    assert "still shows frame 6" in fault.message


@pytest.mark.parametrize("steps", [3, 4, 16])
def test_all_late_by_one(steps: int) -> None:
    fault = _only(check_frames(np.roll(_frames(PATTERNS[steps]), 1, axis=0), PATTERNS[steps]))
    assert fault.kind is FaultKind.STALE
    assert len(fault.frames) == PATTERNS[steps].n_frames
    assert "late" in fault.message


@pytest.mark.parametrize(
    ("steps", "pair"), [(3, (1, 2)), (4, (1, 3)), (4, (6, 9)), (4, (2, 30)), (16, (6, 9)), (16, (2, 94))]
)
def test_swapped(steps: int, pair: tuple[int, int]) -> None:
    # (1, 3) of four steps leaves a perfect sinusoid with the wrong sign of the phase: no residual shows it.
    frames = _frames(PATTERNS[steps])
    frames[list(pair)] = frames[list(pair)[::-1]]
    fault = _only(check_frames(frames, PATTERNS[steps]))
    assert (fault.kind, fault.frames) == (FaultKind.SWAPPED, pair)


@pytest.mark.parametrize("steps", [3, 4, 16])
def test_corrupt_in_whole_or_in_part(steps: int) -> None:
    frames = _frames(PATTERNS[steps])
    frames[7] = 0
    fault = _only(check_frames(frames, PATTERNS[steps]))
    assert (fault.kind, fault.frames) == (FaultKind.CORRUPT, (7,))
    frames = _frames(PATTERNS[steps])
    frames[-1, 120:] = 128  # the last quarter of a truncated file
    fault = _only(check_frames(frames, PATTERNS[steps]))
    assert (fault.kind, fault.frames) == (FaultKind.CORRUPT, (len(frames) - 1,))


def test_wrong_steps_are_found_with_value_and_sigma() -> None:
    true = np.arange(16) * 2 * np.pi / 15
    frames = Scene().frames(PATTERNS[16], np.random.default_rng(3), steps=lambda fringes: true)
    faults = check_frames(frames, PATTERNS[16])
    assert {fault.kind for fault in faults} == {FaultKind.WRONG_STEP}
    assert len(faults) == 6
    found = re.search(r"the steps are ([\d.]+) \+- ([\d.]+) deg", faults[0].message)
    assert found is not None
    assert abs(float(found[1]) - 24) < 5 * float(found[2]) < 0.05
    assert "not 22.500 deg" in faults[0].message
    only_one = Scene().frames(
        PATTERNS[16],
        np.random.default_rng(3),
        steps=lambda fringes: true if fringes.periods == 3.9 else equal_steps(16),
    )
    assert {fault.frames[0] for fault in check_frames(only_one, PATTERNS[16])} == {16, 64}


def test_steps_of_four_frames_are_found_by_the_finer_sets() -> None:
    frames = Scene().frames(
        PATTERNS[4],
        np.random.default_rng(4),
        steps=lambda fringes: np.radians([0, 82, 164, 246]) if fringes.periods == 3.9 else equal_steps(4),
    )
    faults = check_frames(frames, PATTERNS[4])
    assert {(fault.kind, fault.frames[0]) for fault in faults} == {
        (FaultKind.WRONG_STEP, 4),
        (FaultKind.WRONG_STEP, 20),
    }


@pytest.mark.parametrize("n", [5, 8, 16])
def test_step_sigmas_are_honest(n: int) -> None:
    rng = np.random.default_rng(n)
    true = np.arange(n) * 2 * np.pi / (n - 0.5)
    ratios = []
    for _ in range(60):
        phase = rng.uniform(0, 2 * np.pi, 500)
        light = 110 + 60 * np.cos(phase - true[:, None]) + rng.standard_normal((n, 500))
        found = estimate_steps(light, equal_steps(n))
        ratios.append((found.steps_rad - true)[1:] / found.sigma_rad[1:])
    # All share the first frame's error, so 60 series count, not 60 (n - 1): 99 % within 0.5.
    assert np.mean(np.concatenate(ratios) ** 2) == pytest.approx(1.0, abs=0.5)


@pytest.mark.parametrize("steps", [4, 16])
def test_gamma(steps: int) -> None:
    fault = _only(check_frames(_frames(PATTERNS[steps], gamma=2.2), PATTERNS[steps]))
    assert (fault.kind, fault.severity) == (FaultKind.GAMMA, "doubt")
    assert "level**2.2" in fault.message or "level**2.1" in fault.message


def test_flicker_and_drift() -> None:
    frames = _frames(PATTERNS[4]).astype(float)
    flicker = frames.copy()
    flicker[4] *= 1.04
    fault = _only(check_frames(np.rint(flicker).astype(np.uint8), PATTERNS[4]))
    assert (fault.kind, fault.frames, fault.severity) == (FaultKind.EXPOSURE, (4,), "doubt")
    drift = frames * np.linspace(1, 0.92, 32)[:, None, None]
    fault = _only(check_frames(np.rint(drift).astype(np.uint8), PATTERNS[4]))
    assert fault.kind is FaultKind.EXPOSURE
    assert "drifts" in fault.message


def test_saturation() -> None:
    fault = _only(check_frames(_frames(PATTERNS[4], offset_dn=163.5), PATTERNS[4]))
    assert (fault.kind, fault.severity) == (FaultKind.SATURATION, "doubt")
    fault = _only(check_frames(_frames(PATTERNS[4], offset_dn=200.0), PATTERNS[4]))
    assert (fault.kind, fault.severity) == (FaultKind.SATURATION, "error")
    fault = _only(check_frames(_frames(PATTERNS[4]), PATTERNS[4], saturation_dn=199.0))
    assert fault.kind is FaultKind.SATURATION


@pytest.mark.parametrize("steps", [3, 4, 16])
def test_no_fringes(steps: int) -> None:
    fault = _only(check_frames(_frames(PATTERNS[steps], modulation_dn=0.0), PATTERNS[steps]))
    assert (fault.kind, fault.severity) == (FaultKind.LOW_MODULATION, "error")


def test_a_set_lost_in_blur() -> None:
    frames = Scene().readings(PATTERNS[4], np.random.default_rng(5))
    frames[28:] = 110 + 0.005 * (frames[28:] - 110) + np.random.default_rng(6).standard_normal(frames[28:].shape)
    faults = check_frames(np.rint(frames).astype(np.uint8), PATTERNS[4])
    assert faults
    assert all(set(fault.frames) <= set(range(28, 32)) or not fault.frames for fault in faults)


def test_wrong_number_and_not_finite() -> None:
    frames = _frames(PATTERNS[4])
    assert _only(check_frames(frames[:-1], PATTERNS[4])).kind is FaultKind.FRAME_COUNT
    floats = frames.astype(np.float32)
    floats[3] = np.nan
    fault = _only(check_frames(floats, PATTERNS[4]))
    assert (fault.kind, fault.frames, fault.severity) == (FaultKind.NOT_FINITE, (3,), "error")
    few = frames.astype(np.float32)
    few[3, :9] = np.inf
    assert _only(check_frames(few, PATTERNS[4])).severity == "doubt"


@pytest.mark.parametrize(
    ("steps_deg", "said", "unsaid"),
    [
        ((0.0, 86.0, 172.0, 258.0), "write the true steps into [[pattern.set]]", "uneven"),
        ((0.0, 72.0, 145.0, 261.0), "light that changes from frame to frame", "write the true steps"),
    ],
    ids=["even", "uneven"],
)
def test_steps_are_taken_for_what_was_displayed_where_they_are_even(steps_deg, said, unsaid) -> None:
    """Displays step evenly; light that changes makes other steps."""
    planned = make_pattern([0.9, 3.9, 15.9], [0.9, 3.9, 15.9])
    first, second, *rest = planned.sets
    shown = FringePattern((first, replace(second, steps_rad=np.deg2rad(steps_deg)), *rest))
    faults = check_frames(_frames(shown), planned)
    [fault] = [one for one in faults if one.kind is FaultKind.WRONG_STEP]
    assert said in fault.message
    assert unsaid not in fault.message
