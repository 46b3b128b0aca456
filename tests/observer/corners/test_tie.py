"""Where a drone's positions have collectors: from photos that must agree, whichever row or half turn each one shows."""

from collections.abc import Callable

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import FittedPose, FoundLine
from observer.corners.tie import SearchedCollector, SearchedPhoto, Tied, tie
from observer.trough.collector import Collector

CAMERA = Camera(400, 300, 500.0, 500.0, 199.5, 149.5)
#: How the rows run, and where the common origin is in the drone's positions.
TURN = rotation_from_vector([0.0, 0.0, -0.3])
ORIGIN = np.array([120.0, -40.0, 3.0])
ROW = np.array([7.0, 0.0, 0.0])
HALF = RigidTransform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def collector(place_m: np.ndarray, edges_y_m: tuple[float, ...] = (-1.5, 0.0, 1.5)) -> SearchedCollector:
    edges = np.array([-2.5, -1.3, 0.0, 1.3, 2.5]), np.array(edges_y_m)
    design = Collector(5.0, 3.0, 1.49, 0.07, None, *edges, 0.01)
    return SearchedCollector(PanelLattice(design, 2e-3, 1e-3), TURN, TURN @ place_m, np.zeros(3), 0.03)


def pose_from(eye_m: np.ndarray) -> RigidTransform:
    down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    return RigidTransform(down, -down @ eye_m)


def fitted(pose: RigidTransform, one: SearchedCollector) -> FittedPose:
    """Return a pose whose lines are all seen."""
    lines = tuple(FoundLine(line, 0.0, 0.0, 0.5, 1e-4 * np.eye(2), 0.95) for line in one.lattice.lines)
    return FittedPose(pose, lines, np.full(len(lines), 20), 1e-8 * np.eye(6))


def searched(
    eyes_m: list[np.ndarray], collectors: list[SearchedCollector], rows: list[np.ndarray], halves: tuple[bool, ...]
) -> Tied:
    """Tie photos in which each row is seen, as it is and after half a turn.

    eyes_m: In the common frame.
    rows: Where rows really are in it.
    """
    photos = [
        SearchedPhoto(str(k), np.zeros((300, 400), np.float32), CAMERA, ORIGIN + TURN @ eye, np.full(3, 0.02), None)
        for k, eye in enumerate(eyes_m)
    ]

    def each(_: Callable[[int], list[list[FittedPose]]], count: int) -> list[list[list[FittedPose]]]:
        found = []
        for k in range(count):
            near = [row for row in rows if np.linalg.norm(row - eyes_m[k]) < 13.0]
            poses = [
                pose_from(eyes_m[k] - row) @ (HALF if half else RigidTransform.identity())
                for row in near
                for half in halves
            ]
            found.append([[fitted(pose, collectors[0]) for pose in poses]])
        return found

    return tie(photos, collectors, each)


EYES = [np.array([x, 0.0, 12.0]) for x in (-2.0, 1.0, 3.5, 6.0, 9.0)]


def test_two_rows_that_look_the_same_and_half_turns() -> None:
    rows = [collector(np.zeros(3)), collector(ROW)]
    tied = searched(EYES, rows, [np.zeros(3), ROW], (False, True))
    np.testing.assert_allclose(tied.origin_m, ORIGIN, atol=1e-9)
    np.testing.assert_allclose(tied.origin_of(rows[1]), ORIGIN + TURN @ ROW, atol=1e-9)
    # From between the rows a photo may as well be one of the other row, from the other side: it says no heading.
    expected = TURN @ pose_from(EYES[0]).rotation.T
    assert {tuple(one.place_m.round(6)) for one in tied.headings} == {
        tuple((ORIGIN + TURN @ EYES[k]).round(6)) for k in (0, 1, 3, 4)
    }
    for one in tied.headings:
        np.testing.assert_allclose(one.enu_from_camera, expected, atol=1e-9)


def test_rows_beside_the_stated_ones_are_refused_though_fewer_photos_show_them() -> None:
    stated, eyes = [np.zeros(3), ROW], [np.array([x, 0.0, 12.0]) for x in np.linspace(-9, 16, 11)]
    modules = [collector(place) for place in stated]
    np.testing.assert_allclose(searched(eyes, modules, stated, (False,)).origin_m, ORIGIN, atol=1e-9)
    with pytest.raises(EstimationError, match="more rows than the 2 modules"):
        searched(eyes, modules, [-ROW, *stated, 2 * ROW], (False,))


def test_one_photo_does_not_tell_half_a_turn() -> None:
    with pytest.raises(EstimationError, match="two places"):
        searched(EYES[:1], [collector(np.zeros(3))], [np.zeros(3)], (False, True))
    tied = searched(EYES[:2], [collector(np.zeros(3))], [np.zeros(3)], (False, True))
    np.testing.assert_allclose(tied.origin_m, ORIGIN, atol=1e-9)


def test_only_even_drawings_are_the_same_after_half_a_turn() -> None:
    assert collector(np.zeros(3)).is_symmetric
    assert not collector(np.zeros(3), (-1.5, 0.2, 1.5)).is_symmetric
