"""Faults do to the frames what their names say."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from data_synth.fringes.faults import Fault, FaultKind, frame_sources, shown_pattern
from data_synth.fringes.presets import facet_scene, rectangle
from data_synth.fringes.scene import FringeScene, render_fringes
from data_synth.optics.mirror import Design, SyntheticFacet
from data_synth.optics.pinhole import PinholeCamera
from deflectometry.setup import make_pattern
from heliogauge.errors import InputError


@pytest.fixture(scope="module")
def scene() -> FringeScene:
    facet = SyntheticFacet("flat", rectangle(1.2, 1.2), Design("plane"))
    camera = PinholeCamera(51, 39, 172.0, 172.0, 25.0, 19.0)
    return replace(facet_scene("flat", (facet,), camera=camera), pattern=make_pattern([0.9, 3.9], [0.9, 3.9]))


def _frames(scene: FringeScene, *faults: str) -> np.ndarray:
    spoilt = replace(scene, faults=tuple(Fault.parse(text) for text in faults))
    return render_fringes(spoilt, np.random.default_rng(0)).frames.astype(float)


def test_a_repeated_frame_is_a_copy_and_a_stale_one_is_not(scene):
    good, repeated, stale = _frames(scene), _frames(scene, "repeated:5"), _frames(scene, "stale:5")
    assert_array_equal(repeated[5], repeated[4])
    difference = stale[5] - stale[4]
    assert 1.2 < difference.std() < 1.8
    assert (good[5] - good[4]).std() > 10
    assert_array_equal(np.delete(repeated, 5, axis=0), np.delete(good, 5, axis=0))


def test_swapped_frames_change_places(scene):
    good, swapped = _frames(scene), _frames(scene, "swapped:2")
    assert (swapped[2] - good[3]).std() < 2
    assert (swapped[3] - good[2]).std() < 2
    assert (swapped[2] - good[2]).std() > 10


def test_a_corrupt_frame_misses_its_lower_third(scene):
    corrupt = _frames(scene, "corrupt:7")
    assert corrupt[7, 26:].max() == 0
    assert corrupt[7, :26].max() > 100


def test_wrong_steps_are_those_of_one_frame_less(scene):
    shown = shown_pattern(scene.pattern, (Fault.parse("wrong-step"),))
    assert_allclose(np.degrees(shown.sets[0].steps_rad), [0, 120, 240, 360])
    assert shown.n_frames == scene.pattern.n_frames
    frames = _frames(scene, "wrong-step")
    assert (frames[3] - frames[0]).std() < 2


def test_drift_and_saturation(scene):
    good, drift, bright = _frames(scene), _frames(scene, "drift:0.03"), _frames(scene, "saturated:1.6")
    inside = good.max(axis=0) > 100
    assert drift[-1][inside].mean() - 4 == pytest.approx(1.03 * (good[-1][inside].mean() - 4), rel=2e-3)
    assert drift[0][inside].mean() == pytest.approx(good[0][inside].mean(), rel=1e-9)
    assert (bright == 255).mean() > 0.03
    assert (good == 255).mean() == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [("upside-down", "one of repeated"), ("gamma:much", "a number"), ("swapped:15", "0 to 15"), ("stale:0", "0 to 15")],
)
def test_impossible_faults_are_refused(scene, text, said):
    with pytest.raises(InputError) as caught:
        frame_sources(scene.pattern.n_frames, (Fault.parse(text),))
    assert said in str(caught.value)


def test_every_kind_has_a_default():
    assert [Fault.parse(kind).kind for kind in FaultKind] == list(FaultKind)
