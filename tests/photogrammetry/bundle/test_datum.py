"""Datum: movements that no image point sees, and how the datum's choice is made and said."""

import tracemalloc

import numpy as np
import pytest

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.bundle.alignment import aligned_to_constraints, aligned_to_control, transformed
from photogrammetry.bundle.constraints import AXES, ControlPoint, Coordinate, Distance
from photogrammetry.bundle.datum import (
    Datum,
    DatumKind,
    datum_constraints,
    free_movements,
    moved_as_a_whole,
    similarity_movements,
)
from photogrammetry.bundle.state import BundleState
from tests.photogrammetry.bundle_networks import network

ALL = np.arange(12)


def small():
    truth, _ = network(np.random.default_rng(2), 5, 12)
    return truth


def pixels(state):
    camera = state.cameras[0]
    return np.stack([camera.project(state.cam_from_world(i).apply(state.points_m)) for i in range(5)])


def test_no_image_point_sees_a_similarity():
    truth = small()
    rng = np.random.default_rng(0)
    center = truth.points_m.mean(axis=0)
    moved = moved_as_a_whole(truth, rng.normal(size=7) * 0.5, center)
    np.testing.assert_allclose(pixels(moved), pixels(truth), atol=1e-8)
    turn = RigidTransform.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))
    np.testing.assert_allclose(pixels(transformed(truth, turn, 3.0)), pixels(truth), atol=1e-8)


def test_movements_are_the_derivatives_of_that_similarity():
    truth = small()
    center = np.array([0.3, -0.2, 0.5])
    movements = similarity_movements(truth, center)
    for k in range(7):
        step = 1e-6 * np.eye(7)[k]
        forth, back = (moved_as_a_whole(truth, sign * step, center) for sign in (1, -1))
        np.testing.assert_allclose((forth.points_m - back.points_m) / 2e-6, movements.points[:, :, k], atol=1e-8)
        shift = (forth.translations_m - back.translations_m) / 2e-6
        np.testing.assert_allclose(shift, movements.poses[:, 3:, k], atol=1e-7)
        for i in range(5):
            turn = RigidTransform(forth.rotations[i] @ back.rotations[i].T, np.zeros(3)).rotation_vector_rad / 2e-6
            np.testing.assert_allclose(turn, movements.poses[i, :3, k], atol=1e-7)


@pytest.mark.parametrize(
    ("known", "fixed", "left", "text"),
    [
        ((), (), 7, "3 of position, 3 of rotation, scale"),
        ((Distance("0", "1", 1.0, 1.0),), (), 6, "3 of position, 3 of rotation"),
        ((), (3,), 4, "3 of rotation, scale"),
        ((), (3, 4), 1, "1 of rotation"),
        ((), (3, 4, 5), 0, "nothing"),
        (tuple(Coordinate("0", axis, 0.0, 1.0) for axis in AXES), (), 4, "3 of rotation, scale"),
    ],
)
def test_what_constraints_leave_free(known, fixed, left, text):
    truth = small()
    targets = [np.array([int(name) for name in one.targets]) for one in known]
    rows = [one.rows(truth.points_m[own])[1] for one, own in zip(known, targets, strict=True)]
    free = free_movements(similarity_movements(truth), rows, targets, np.array(fixed, dtype=np.intp))
    assert free.count == left
    assert free.describe() == text


def test_datum_of_three_targets_on_a_line_is_refused():
    truth = small()
    line = np.array(truth.points_m)
    line[1], line[2] = line[0] + 1.0, line[0] + 2.0
    bent = type(truth)(truth.cameras, truth.rotations, truth.translations_m, line)
    with pytest.raises(EstimationError, match="not on one line"):
        datum_constraints(Datum(), similarity_movements(bent), np.array([0, 1, 2]))
    with pytest.raises(EstimationError, match="2 targets do not define"):
        datum_constraints(Datum(), similarity_movements(truth), np.array([0, 1]))
    with pytest.raises(InputError, match="three targets"):
        Datum(DatumKind.MINIMAL, ("a", "b"))


def test_alignment_to_control_points_and_constraints():
    truth = small()
    names = tuple(str(i) for i in range(12))
    turn = RigidTransform.from_rotation_vector([1.0, -2.0, 0.5], [3.0, 1.0, -2.0])
    away = transformed(truth, turn, 0.37)
    control = {str(i): truth.points_m[i] for i in (0, 3, 5, 7)}
    np.testing.assert_allclose(aligned_to_control(away, names, control).points_m, truth.points_m, atol=1e-9)
    length = float(np.linalg.norm(truth.points_m[2] - truth.points_m[9]))
    known = [Distance("2", "9", length, 1e-5), Coordinate("11", "x", truth.points_m[11, 0], 1e-6)]
    known += [ControlPoint(name, point, np.eye(3) * 1e-6) for name, point in control.items()]
    found = aligned_to_constraints(away, names, known)
    np.testing.assert_allclose(found.points_m, truth.points_m, atol=1e-6)
    scaled = aligned_to_constraints(away, names, known[:1])
    assert np.linalg.norm(scaled.points_m[2] - scaled.points_m[9]) == pytest.approx(length)
    np.testing.assert_allclose(pixels(found), pixels(truth), atol=1e-4)
    with pytest.raises(EstimationError, match="three common points"):
        aligned_to_control(away, names, {"0": truth.points_m[0]})
    line = {str(i): np.array([float(i), 0, 0]) for i in range(3)}
    with pytest.raises(EstimationError, match="one line"):
        aligned_to_control(away, names, line)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_trough_that_fits_its_rims_both_ways_is_seen_from_above(seed):
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, 12.0, 6)
    rims = np.concatenate([np.column_stack([np.full(6, side), along, np.full(6, 1.2)]) for side in (-2.9, 2.9)])
    rims += rng.normal(0, 5e-4, rims.shape)
    ground = np.array([[1.0, 3.0, -2.0], [-2.0, 9.0, -2.0]])
    above = [RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, y, 9.0])) for y in (2.0, 9.0)]
    truth = BundleState.from_poses(small().cameras, above, np.concatenate([rims, ground]))
    known = [
        Coordinate(str(i), axis, round(rims[i, k], 1), 5e-4) for i in range(12) for k, axis in ((0, "x"), (2, "z"))
    ]
    known += [Coordinate(name, "y", 0.0, 5e-4) for name in ("0", "6")]
    turned = transformed(truth, RigidTransform.from_rotation_vector(rng.normal(size=3) * 2, rng.normal(size=3)), 0.4)
    found = aligned_to_constraints(turned, [str(i) for i in range(14)], known)
    np.testing.assert_allclose(found.points_m, truth.points_m, atol=5e-3)


def test_thousands_of_control_points_need_little_memory():
    # A full left factor of the 6000 rows of 2000 fixed targets alone would be 288 MB.
    truth, _ = network(np.random.default_rng(2), 5, 2000)
    movements = similarity_movements(truth)
    tracemalloc.start()
    free = free_movements(movements, [], [], np.arange(2000))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert free.count == 0
    assert peak < 20e6


def test_one_photo_holds_no_scale():
    movements = similarity_movements(small())
    with pytest.raises(EstimationError, match=r"1 photos do not define .*scale of the network; name a second photo"):
        datum_constraints(Datum(DatumKind.PHOTOS, photos=("0",)), movements, np.array([0]))
    with pytest.raises(InputError, match="one or two photos"):
        Datum(DatumKind.PHOTOS)


def test_control_must_define_everything():
    with pytest.raises(EstimationError, match="leave 3 of position, 3 of rotation, scale open"):
        datum_constraints(Datum(DatumKind.CONTROL), similarity_movements(small()), ALL)
