"""What is exchanged in images or pattern: the map that follows from one measurement is that of measuring anew."""

from dataclasses import replace

import numpy as np
import pytest

from deflectometry.fringes.observation import Observation
from deflectometry.fringes.phase import TURN_RAD
from deflectometry.setup.patterns import Axis, FringePattern, make_pattern
from tests.deflectometry.fringe_drawing import Scene

OTHER = {Axis.X: Axis.Y, Axis.Y: Axis.X}


def _mirrored(pattern: FringePattern, axes: str) -> FringePattern:
    """cos(2 pi P (1 - w) - s) is cos(2 pi P w - (2 pi P - s))."""
    sets = (
        replace(one, steps_rad=TURN_RAD * one.periods - one.steps_rad) if str(one.axis) in axes else one
        for one in pattern.sets
    )
    return FringePattern(tuple(sets))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(shape=(60, 80), cover=0.7)


@pytest.mark.parametrize(
    ("words", "at", "axes"),
    [
        ("left and right of the images", np.s_[:, ::-1], ""),
        ("top and bottom of the images", np.s_[::-1], ""),
        ("images are turned", np.s_[::-1, ::-1], ""),
        ("left and right of the displayed", np.s_[:], "x"),
        ("top and bottom of the displayed", np.s_[:], "y"),
        ("displayed pattern is turned", np.s_[:], "xy"),
        ('axis = "x"', np.s_[:], None),
    ],
)
def test_maps_follow_as_if_measured_anew(scene: Scene, words: str, at: object, axes: str | None) -> None:
    pattern = make_pattern((0.9, 3.9, 15.9), (0.9, 4.3, 12.9))
    frames = scene.frames(pattern, np.random.default_rng(3))
    source, region = Observation(frames, pattern), scene.mirror()
    [found] = [one for one in source.exchanges(source.screen_map(region)) if words in one.words]
    put_right = (
        FringePattern(tuple(replace(one, axis=OTHER[one.axis]) for one in pattern.sets))
        if axes is None
        else _mirrored(pattern, axes)
    )
    turned = np.stack([one[at] for one in frames])
    anew = Observation(turned, put_right).screen_map(region[at])
    follows = found.source.screen_map(region[at])
    assert found.moves_outline == ("images" in words)
    assert np.count_nonzero(anew.flags == 0) > 1000
    np.testing.assert_array_equal(follows.flags, anew.flags)
    good = anew.flags == 0
    for name in ("u", "v"):
        np.testing.assert_allclose(getattr(follows, name)[good], getattr(anew, name)[good], atol=2e-6, err_msg=name)
    for name in ("sigma_u", "sigma_v"):
        np.testing.assert_allclose(getattr(follows, name)[good], getattr(anew, name)[good], rtol=2e-3, err_msg=name)
    np.testing.assert_allclose(found.source.mirror_image(), Observation(turned, put_right).mirror_image(), atol=1e-3)
    # Pixels that are no part of the mirror then are none of its map.
    assert (found.source.screen_map(np.zeros_like(region[at])).flags != 0).all()
