"""Patterns: what is described, and what is displayed."""

import numpy as np
import pytest

from deflectometry.setup.patterns import (
    Axis,
    DisplayLevels,
    FringePattern,
    FringeSet,
    determines_phase,
    equal_steps,
    make_pattern,
    render_frames,
)
from heliogauge.errors import InputError


def test_sets_know_their_frames() -> None:
    pattern = make_pattern([0.9, 7.0], [0.9], steps=3)
    assert pattern.n_frames == 9
    assert [fringes.axis for fringes in pattern.sets] == [Axis.Y, Axis.X, Axis.X]
    assert [(fringes.periods, position) for fringes, position in pattern.sets_of(Axis.X)] == [
        (0.9, slice(3, 6)),
        (7.0, slice(6, 9)),
    ]
    assert pattern.describe_frame(7) == "frame 7 (x fringes, 7 periods, step 120 deg)"
    with pytest.raises(InputError, match="frames 0 to 8"):
        pattern.describe_frame(9)


@pytest.mark.parametrize(
    "steps_deg", [[0, 180], [0, 0, 0, 0], [0, 180, 0, 180], [0, 120, 120, 0], [0, 360, 720], [10, 370, 190]]
)
def test_steps_that_do_not_determine_the_phase_are_refused(steps_deg: list[float]) -> None:
    assert not determines_phase(np.radians(steps_deg))
    with pytest.raises(InputError, match="do not determine the phase"):
        FringeSet(Axis.X, 1.0, np.radians(steps_deg))


@pytest.mark.parametrize("steps_deg", [[0, 90, 180], [0, 120, 240], [3, 17, 211, 305, 40], [0, 10, 20]])
def test_any_three_different_steps_do(steps_deg: list[float]) -> None:
    assert determines_phase(np.radians(steps_deg))


def test_impossible_patterns_are_refused() -> None:
    with pytest.raises(InputError, match="axis = 'y'"):
        FringePattern((FringeSet(Axis.X, 1.0, equal_steps(3)),))
    with pytest.raises(InputError, match="positive"):
        FringeSet(Axis.X, 0.0, equal_steps(3))
    with pytest.raises(InputError, match="at least 3"):
        equal_steps(2)
    with pytest.raises(InputError, match="bit depth"):
        DisplayLevels(bits=4)
    with pytest.raises(InputError, match="minimum < maximum"):
        DisplayLevels(minimum=0.7, maximum=0.7)
    with pytest.raises(InputError, match="ascending"):
        DisplayLevels(level_from_light=np.array([0.0, 0.6, 0.5, 1.0]))


def test_frames_show_the_pattern_at_pixel_centres() -> None:
    pattern = make_pattern([2.0], [0.9], steps=4)
    frames = list(render_frames(pattern, 64, 32, DisplayLevels(bits=16)))
    assert [frame.shape for frame in frames] == [(32, 64)] * 8
    assert {frame.dtype for frame in frames} == {np.dtype(np.uint16)}
    assert np.array_equal(frames[0], np.broadcast_to(frames[0][:, :1], (32, 64)))  # y fringes first: rows are uniform
    stack = np.stack(frames[4:]).astype(float)
    phase = np.arctan2(stack[1] - stack[3], stack[0] - stack[2])[0]
    expected = 2 * np.pi * 2.0 * (np.arange(64) + 0.5) / 64
    assert np.abs(np.angle(np.exp(1j * (phase - expected)))).max() < 1e-4  # rounding to 16 bits


def test_levels_and_compensation_make_linear_light() -> None:
    pattern = make_pattern([3.0], [1.0], steps=3)
    level_from_light = np.linspace(0.0, 1.0, 1025) ** (1 / 2.2)
    levels = DisplayLevels(minimum=0.2, maximum=0.9, bits=16, level_from_light=level_from_light)
    frame = list(render_frames(pattern, 400, 4, levels))[3][0] / 65535
    assert frame.min() == pytest.approx(0.2, abs=1e-3)
    assert frame.max() == pytest.approx(0.9, abs=1e-3)
    light = frame**2.2
    phase = 2 * np.pi * 3 * (np.arange(400) + 0.5) / 400
    design = np.stack([np.ones(400), np.cos(phase), np.cos(2 * phase), np.cos(3 * phase)], axis=1)
    _, first, second, third = np.linalg.lstsq(design, light, rcond=None)[0]
    assert abs(second / first) < 1e-3  # uncompensated: 0.29
    assert abs(third / first) < 1e-3
