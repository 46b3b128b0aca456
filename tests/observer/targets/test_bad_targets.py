"""Lists of targets that cannot be those of the photos, or tell no frame, are refused with the reason."""

import numpy as np
import pytest

from heliogauge.errors import EstimationError, InputError
from observer.pipeline.inputs import read_targets
from observer.targets.list_checks import (
    exchanged_pairs,
    intersect,
    refuse_loose_frame,
    refuse_strange_targets,
    refuse_upside_down,
    stray_targets,
)
from observer.trough.collector import ls2

RIMS = np.array([[side * 2.7, y, 1.05] for side in (-1, 1) for y in (-3.0, 0.0, 3.0)])
KNOWN = np.full(RIMS.shape, 1e-3)


def test_names_that_no_photo_shows():
    refuse_strange_targets(("1", "2", "3", "77"), ("1", "2", "3", "4"), "targets.csv")
    with pytest.raises(InputError, match=r"3 targets in targets.csv \(101, 102, 103\) the photos show 0, and 4 in all"):
        refuse_strange_targets(("101", "102", "103"), ("2", "1", "10", "9"), "targets.csv")
    # A photo network of dots without a code has no names yet.
    refuse_strange_targets(("dot1", "dot2", "dot3"), (), "targets.csv")


def test_a_frame_that_is_held():
    refuse_loose_frame(RIMS, KNOWN)
    partly = KNOWN.copy()
    partly[:, 2] = np.nan
    partly[[0, 2, 4], 2] = 2e-3
    refuse_loose_frame(RIMS, partly)


@pytest.mark.parametrize(
    ("points", "sigma", "axis"),
    [
        (RIMS[:3], KNOWN[:3], "y"),  # one rim
        (RIMS[[0, 3]], KNOWN[[0, 3]], "x"),  # two targets
        (RIMS, KNOWN * [1, 1, np.nan], "z|x|y"),  # no height at all
        (RIMS, KNOWN * 30, "y|x"),  # known to 30 mm
    ],
)
def test_a_frame_that_is_free_to_turn(points, sigma, axis):
    with pytest.raises(EstimationError, match=rf"free to turn, mostly about ({axis}); list"):
        refuse_loose_frame(points, sigma)


def test_height_with_the_wrong_sign():
    refuse_upside_down(RIMS, ls2())
    ground = RIMS - [0.0, 0.0, 4.2]
    refuse_upside_down(ground, ls2())
    with pytest.raises(InputError, match="change the sign of z_m"):
        refuse_upside_down(RIMS * [1, 1, -1], ls2())


def test_strays_are_few_and_far():
    sigma = np.full(12, 0.3)
    usual = np.linspace(0.1, 0.9, 12)
    assert not stray_targets(usual, sigma).any()
    exchanged = usual.copy()
    exchanged[[2, 8]] = 400.0
    assert np.flatnonzero(stray_targets(exchanged, sigma)).tolist() == [2, 8]
    # A wrong camera puts the outer ones further off, but half of the others too.
    assert not stray_targets(np.array([4.0, 0.8, 1.0, 1.0, 0.8, 4.0] * 2), sigma).any()
    # With four, and with half of them, nobody knows which are right.
    assert not stray_targets(np.array([0.1, 0.1, 0.1, 90.0]), sigma[:4]).any()
    assert not stray_targets(np.array([0.1] * 6 + [90.0] * 6), sigma).any()
    assert not stray_targets(np.zeros(0), np.zeros(0)).any()


def test_lines_of_sight_meet_where_the_target_is():
    place, eyes = np.array([2.7, 1.0, 1.05]), np.array([[-2.0, 0.0, 12.0], [0.5, 0.3, 12.0], [3.0, 0.0, 12.0]])
    np.testing.assert_allclose(intersect(eyes, 3 * (place - eyes)), place, atol=1e-12)
    # From one place, and from two that are 0.1 m apart 12 m away, it may be anywhere along the line.
    assert intersect(eyes[:1], (place - eyes)[:1]) is None
    close = eyes[0] + np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    assert intersect(close, place - close) is None


def test_two_exchanged_entries_are_found_and_a_moved_one_is_not():
    listed, sigma = RIMS.copy(), np.full(6, 1e-3)
    # Photos show 1 where the list has 4 and 4 where it has 1, to 2 mm; 2 was moved by half a metre.
    seen = {1: listed[4] + [0.002, 0, 0], 4: listed[1] - [0, 0.002, 0], 2: listed[2] + [0.5, 0, 0]}
    assert exchanged_pairs(seen, listed, sigma, 2e-3) == [(1, 4)]
    assert exchanged_pairs({1: listed[4], 2: listed[5]}, listed, sigma, 2e-3) == []
    # A dot without a code is not seen under its name where it is listed.
    assert exchanged_pairs({1: listed[4]}, listed, sigma, 2e-3, [4]) == [(1, 4)]
    assert exchanged_pairs({1: listed[3]}, listed, sigma, 2e-3, [4]) == []
    # Where three went round nobody can say which two were exchanged.
    assert exchanged_pairs({0: listed[1], 1: listed[2], 2: listed[0]}, listed, sigma, 2e-3) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"target;x_m;y_m;z_m\n1;0,5;1;0\n", "save it with commas and decimal points"),
        ("target,x_m,y_m,z_m\nSüd,0,1,0\n".encode("latin1"), "save it as UTF-8"),
    ],
)
def test_tables_as_other_programs_save_them(tmp_path, content, said):
    (tmp_path / "targets.csv").write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_targets(tmp_path / "targets.csv")
