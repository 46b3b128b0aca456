"""Entries of the panels' edges that photos show elsewhere than they are stated, in both directions, or do not show."""

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.doubts import Severity
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import Float32Array, FloatArray
from observer.corners.lattice import PanelLattice
from observer.corners.stated_edges import StatedEdge, stated_edges, strange_edges
from observer.photo_edges.views import View
from observer.pipeline.panels import all_aside, stated_doubts
from observer.trough.collector import Collector

X_M, Y_M = np.array([-2.5, -1.3, 0.0, 1.3, 2.5]), np.array([-2.4, -0.8, 0.9, 2.4])
#: Places of cameras across the trough: the receiver hides another part of the mirror from each [m].
EYES_X_M = (-0.6, 0.5, 1.1)
FOCAL_PX = 2000.0


def views() -> list[View]:
    # From straight above: +x runs down the photo and +y to the right.
    down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    camera = Camera(1100, 1100, FOCAL_PX, FOCAL_PX, 549.5, 549.5)
    return [View(camera, RigidTransform(down, -down @ np.array([x, 0.1, 12.0]))) for x in EYES_X_M]


def drawn(view: View, rng: np.random.Generator) -> Float32Array:
    """Draw rims and joints where X_M and Y_M have them; lines of constant y are bent."""
    row, column = np.arange(1100.0), np.arange(1100.0)
    x_of_row = np.linspace(-3.2, 3.2, 4001)
    at_row = view.project(np.stack([x_of_row, np.zeros(4001), x_of_row**2 / (4 * 1.49)], axis=1))[:, 1]
    x = np.interp(row, at_row, x_of_row)
    pixel_m = (12.0 - x**2 / (4 * 1.49)) / FOCAL_PX
    y = 0.1 + (column - 549.5) * pixel_m[:, None]
    inside = (np.abs(x) < X_M[-1])[:, None] & (np.abs(y) < Y_M[-1])
    lines = sum(np.exp(-0.5 * ((x - edge) / (0.9 * pixel_m)) ** 2)[:, None] for edge in X_M[1:-1])
    lines = lines + sum(np.exp(-0.5 * ((y - edge) / (0.9 * pixel_m[:, None])) ** 2) for edge in Y_M[1:-1])
    image = np.where(inside, 150 - 70 * np.minimum(lines, 1.0), 60.0)
    return (image + 2.0 * rng.standard_normal(image.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def photos() -> list[Float32Array]:
    rng = np.random.default_rng(3)
    return [drawn(view, rng) for view in views()]


def found(photos: list[Float32Array], x_m: FloatArray, y_m: FloatArray) -> tuple[StatedEdge, ...]:
    lattice = PanelLattice(Collector(5.0, 4.8, 1.49, 0.07, None, x_m, y_m, 0.01), 3e-3, 1e-3)
    return stated_edges(photos.__getitem__, views(), lattice)


def test_edges_as_drawn_are_where_they_are_stated(photos: list[Float32Array]) -> None:
    edges = found(photos, X_M, Y_M)
    assert {(one.axis, one.number) for one in edges} >= {(0, 1), (0, 3), (1, 1), (1, 2)}
    assert all(one.is_seen for one in edges)
    assert max(abs(one.beside_m) for one in edges) < 1e-3
    assert not strange_edges(edges)


@pytest.mark.parametrize("off_m", [0.010, -0.030, 0.060])
def test_all_entries_elsewhere_are_named_with_their_place(photos: list[Float32Array], off_m: float) -> None:
    x_m, y_m = X_M + off_m * np.array([0, 1, 0, 1, 0]), Y_M + off_m * np.array([0, 0, 1, 0])
    strange = strange_edges(found(photos, x_m, y_m))
    assert [(one.axis, one.number) for one in strange] == [(0, 1), (0, 3), (1, 2)]
    np.testing.assert_allclose([one.beside_m for one in strange], -off_m, atol=1e-3)


def test_joint_that_is_not_there_is_named(photos: list[Float32Array]) -> None:
    strange = strange_edges(found(photos, X_M, np.array([-2.4, -0.8, 0.2, 0.9, 2.4])))
    assert [(one.axis, one.number, one.is_seen) for one in strange] == [(1, 2, False)]
    # With hardly any joint seen the photos may be too coarse to show them.
    bare = [np.where(one > 100, 150, one).astype(np.float32) for one in photos]
    assert not [one for one in strange_edges(found(bare, X_M, Y_M)) if not one.is_rim]


def test_an_edge_of_which_two_lines_are_shown_is_not_judged(photos: list[Float32Array]) -> None:
    # In one photo a joint along the trough has a line in each of two panels.
    lattice = PanelLattice(Collector(5.0, 4.8, 1.49, 0.07, None, X_M, np.array([-2.4, 0.2, 2.4]), 0.01), 3e-3, 1e-3)
    assert not [one for one in stated_edges(photos.__getitem__, views()[:1], lattice) if one.axis == 0]
    assert [one for one in stated_edges(photos.__getitem__, views()[:2], lattice) if one.axis == 0]


def edge(axis: int, number: int, beside_m: float, *, is_rim: bool = False) -> StatedEdge:
    return StatedEdge(axis, number, beside_m, 0.0 if np.isnan(beside_m) else 1.0, 0.01, is_rim)


def said(edges: list[StatedEdge]) -> list[tuple[str, Severity, bool]]:
    lattice = PanelLattice(Collector(5.0, 4.8, 1.49, 0.07, None, X_M, Y_M, 0.01), 3e-3, 1e-3)
    return [(one.code, one.severity, "from the vertex" in one.text) for one in stated_doubts(edges, lattice)]


def test_closed_joints_along_one_axis_are_not_named() -> None:
    seen, closed = [edge(0, number, 0.0) for number in (1, 2, 3)], [edge(1, number, np.nan) for number in (1, 2)]
    assert said([*seen, *closed]) == []
    assert said([*seen, *closed, *(edge(1, number, 0.0) for number in (3, 4, 5))]) != []


def test_steps_beside_rims_are_a_note_as_they_may_be_a_frame() -> None:
    joints = [edge(0, number, 0.0) for number in (1, 2, 3)]
    frame = [edge(0, 0, -0.06, is_rim=True), edge(0, 4, 0.06, is_rim=True)]
    assert said([*joints, *frame]) == [("stated_rims_beside", Severity.NOTE, False)]


def test_all_that_are_seen_to_one_side_ask_for_the_origin_of_the_list() -> None:
    # Entry 3 is behind the receiver in all photos.
    shifted = [edge(0, 1, 0.02), edge(0, 3, 0.02)]
    named, all_wrong = [("stated_panel_edges_wrong", one) for one in (Severity.DOUBT, Severity.SERIOUS)]
    assert said(shifted) == [(*all_wrong, True)]
    assert said([*shifted, edge(0, 0, np.nan, is_rim=True)]) == [(*all_wrong, True)]
    # A rim, or what looks like one, in its place: the list or the joints.
    assert said([*shifted, edge(0, 4, -0.008, is_rim=True)]) == [(*all_wrong, True)]
    assert said([edge(1, 1, 0.02), edge(1, 2, 0.02)]) == [(*named, True)]
    assert said([edge(0, 1, 0.02), edge(0, 3, -0.02)]) == [(*named, False)]
    assert said([edge(0, 1, 0.02), edge(0, 3, 0.05)]) == [(*named, False)]
    assert said([*shifted, edge(0, 2, 0.0)]) == [(*named, False)]


def test_joints_to_one_side_are_a_list_aside_unless_a_rim_is_in_its_place() -> None:
    lattice = PanelLattice(Collector(5.0, 4.8, 1.49, 0.07, None, X_M, Y_M, 0.01), 3e-3, 1e-3)
    joints = [edge(0, 1, 0.018), edge(0, 2, 0.02), edge(0, 3, 0.021)]
    found = all_aside([*joints, edge(1, 1, 0.0)], lattice)
    assert found is not None
    np.testing.assert_allclose(found.value, [0.02, 0, 0])
    np.testing.assert_allclose(found.contradicting(), [0.02, 0, 0])
    assert all_aside([*joints, edge(0, 4, 0.0, is_rim=True)], lattice) is None
    assert all_aside([*joints[:2], edge(0, 3, 0.0)], lattice) is None
