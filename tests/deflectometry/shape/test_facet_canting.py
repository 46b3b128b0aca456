"""Canting of facets and the moves of their mounts: signs, rigid turns by another route, sigma, facets half measured."""

from dataclasses import replace

import numpy as np
import pytest

from deflectometry.keys import MirrorSection
from deflectometry.shape.facet_canting import FacetCanting, canting_of_facets, doubt_of_canting
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, plane
from heliogauge.slopes.map import SlopeMap
from tests.deflectometry.shape.test_assemble import SQUARE, exact_map, facet_of_optic

MOUNTS = np.array([[-0.15, -0.15], [0.15, -0.15], [0.15, 0.15], [-0.15, 0.15]])


def canted(facet: Facet, slope_map: SlopeMap) -> FacetCanting:
    (found,) = canting_of_facets([facet], {facet.name: slope_map}, {facet.name: MOUNTS})
    return found


@pytest.mark.parametrize(("axis", "moves_mm"), [(0, [0.15, -0.15, -0.15, 0.15]), (1, [0.15, 0.15, -0.15, -0.15])])
def test_a_facet_that_rises_by_1_mrad_goes_back_by_0_15_mm_there(axis: int, moves_mm: list[float]) -> None:
    facet = Facet("flat", SQUARE, plane())
    flat = exact_map(facet, 0.02)
    name = f"slope_{'xy'[axis]}"
    found = canted(facet, replace(flat, **{name: getattr(flat, name) + 1e-3}))
    assert found.canting is not None
    assert found.canting.components_rad[axis] == pytest.approx(1e-3, rel=1e-5)
    assert found.canting.components_rad[1 - axis] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(1e3 * found.moves.move_m, moves_mm, rtol=1e-5)


@pytest.mark.parametrize("turn_rad", [0.0, 0.4, np.pi / 2])
def test_moves_take_a_rigid_turn_of_a_strong_facet_back(turn_rad: float) -> None:
    """The facet is turned as a body, its slopes are those of the turned quadric: mounts go back where they were."""
    facet = facet_of_optic("strong", (0.5, -0.2), turn_rad)
    body = RigidTransform.from_rotation_vector([0.7e-3, -1.1e-3, 0.0], [0.0, 0.0, 0.0])
    ideal = exact_map(facet, 0.02)
    x, y = np.meshgrid(ideal.x_m, ideal.y_m)
    slope_x, slope_y = facet.design.transformed(body).gradient(x, y)
    found = canted(facet, replace(ideal, slope_x=slope_x, slope_y=slope_y))
    places = np.column_stack([MOUNTS, facet.design.height(*MOUNTS.T)])
    out = (body.apply(places) - places)[:, 2]
    np.testing.assert_allclose(found.moves.move_m, -(out - out.mean()), atol=2e-3 * np.abs(out).max())


def test_arrows_are_in_the_frame_of_the_ensemble() -> None:
    """A facet that lies on its side rises towards its own +x, which is the ensemble's +y."""
    pose = RigidTransform.from_rotation_vector([0.0, 0.0, np.pi / 2], [0.5, 0.0, 0.0])
    facet = Facet("side", SQUARE, plane(), pose)
    flat = exact_map(facet, 0.02)
    found = canted(facet, replace(flat, slope_x=flat.slope_x + 1e-3))
    np.testing.assert_allclose(found.rise_rad, [0.0, 1e-3], atol=1e-8)
    np.testing.assert_allclose(found.mounts_in_ensemble_m[1], [0.65, 0.15, 0.0], atol=1e-12)


def test_sigma_of_a_move_is_that_of_the_turn_times_its_lever() -> None:
    """Noise of 10 and 30 urad on n nodes that share it in fours: sigma = s sqrt(4 / n), and moves add x and y."""
    facet = Facet("flat", SQUARE, plane())
    flat = exact_map(facet, 0.02)
    found = canted(facet, flat)
    each = np.array([1e-5, 3e-5]) * np.sqrt(4.0 / np.count_nonzero(flat.valid))
    np.testing.assert_allclose(found.moves.sigma_m, 0.15 * np.hypot(*each), rtol=1e-6)


def test_a_facet_of_which_little_is_measured_has_no_moves() -> None:
    whole, part, none = (Facet(name, SQUARE, plane()) for name in ("whole", "part", "none"))
    flat = exact_map(whole, 0.02)
    holed = replace(flat, slope_x=np.where(np.arange(flat.x_m.size) < 0.6 * flat.x_m.size, np.nan, flat.slope_x))
    names = dict.fromkeys(("whole", "part", "none"), MOUNTS)
    found = canting_of_facets([whole, part, none], {"whole": flat, "part": holed}, names)
    assert [one.canting is None for one in found] == [False, True, True]
    assert [bool(np.isnan(one.moves.move_m).all()) for one in found] == [False, True, True]
    doubt = doubt_of_canting(found)
    assert doubt is not None
    assert doubt.code == "facets_without_canting"
    assert "part, none" in doubt.text
    assert doubt_of_canting(found[:1]) is None


@pytest.mark.parametrize(
    ("mounts_m", "words"),
    [
        ([[150, 150], [-150, 150], [0, -150]], "in metres"),
        ([[-0.1, -0.1], [0.0, 0.0], [0.1, 0.1]], "on a line"),
    ],
)
def test_mounts_that_cannot_be_are_refused(mounts_m: list[list[float]], words: str) -> None:
    facet = {"name": "A", "outline_m": SQUARE.tolist(), "position_m": [0.0, 0.0, 0.0]}
    content = {"design": "plane", "mounts_m": mounts_m}
    with pytest.raises(ValueError, match=words):
        MirrorSection.model_validate({**content, "facet": [facet]})
    with pytest.raises(ValueError, match="facets of an ensemble"):
        MirrorSection.model_validate({**content, "outline_m": SQUARE.tolist()})
