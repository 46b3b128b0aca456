"""Turns of single facets: where images are cut off, hidden or double, and photos that contradict each other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from data_synth.reflections import ReflectionScene, write_overlay
from deflectometry.overlay.camera_place import Station, place_camera
from deflectometry.overlay.facet_fit import FacetFit, Unused, common_turns, fit_facet
from deflectometry.overlay.facet_sight import pixels_within
from deflectometry.overlay.joint_turns import JointTurns, adjust
from deflectometry.overlay.keys import load_overlay_plan
from deflectometry.overlay.planning.plan import PlannedOverlay, PlannedScene
from deflectometry.overlay.planning.predicted_photos import predicted_station
from deflectometry.overlay.source_image import Source, seen_places
from deflectometry.overlay.turn_fit import FacetView, has_foreign_light
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

SMALL = ReflectionScene(columns=2, rows=2, focal_px=3500.0, width_px=300, height_px=300, subpixels=1)
TURN = np.array([1.5e-3, -0.8e-3])
BLUR_M = 0.015


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> PlannedScene:
    folder = tmp_path_factory.mktemp("facet_fit") / "drawn"
    write_overlay(folder, SMALL, 1)
    return PlannedOverlay(load_overlay_plan(folder)).scene()


def view(scene: PlannedScene, photo: int, turn: FloatArray, facet: int = 0) -> FacetView:
    """Return light of a turned facet with noise of 1 DN."""
    seen = pixels_within(scene.camera, scene.poses[photo], scene.facets[facet])
    assert seen is not None
    places = seen_places(seen[1], scene.facets[facet], turn, scene.source)
    noise = np.random.default_rng(photo).normal(0, 1, places.shape[1])
    return FacetView(photo, seen[1], 12 + 158 * scene.source.brightness(places, BLUR_M) + noise, 1.0)


def fit(scene: PlannedScene, views: Sequence[FacetView]) -> FacetFit:
    return fit_facet(scene.facets[0], views, scene.source, None, range(3))


@pytest.mark.parametrize("turn", [TURN, np.array([-6e-3, 3e-3]), np.array([9e-3, 9e-3])])
def test_a_facet_is_found_however_far_it_is_turned_and_cut_off(scene: PlannedScene, turn: FloatArray) -> None:
    every = [view(scene, photo, turn) for photo in range(3)]
    cut = [one.only(one.pixels.pixels_px[:, 0] > np.median(one.pixels.pixels_px[:, 0]) - 10) for one in every]
    for views in (every, cut):
        (found,) = common_turns(scene.facets[0], [one for one in views if one.shows_source], scene.source)
        assert np.linalg.norm(found - turn) < 0.1e-3


def test_two_equal_images_are_ambiguous_and_no_turn_is_chosen(scene: PlannedScene) -> None:
    scene = replace(scene, source=replace(scene.source, half_m=(0.15, 0.15)))
    other = TURN + [0.0, 6e-3]
    both = [
        replace(one, light_dn=np.maximum(one.light_dn, view(scene, one.photo, other).light_dn))
        for one in (view(scene, photo, TURN) for photo in range(3))
    ]
    found = fit(scene, both)
    assert found.rivals_rad is not None
    for turn in (TURN, other):
        assert np.linalg.norm(found.rivals_rad - turn, axis=1).min() < 0.1e-3
    assert not found.turns
    assert dict(found.unused) == dict.fromkeys(range(3), Unused.AMBIGUOUS)


def test_a_source_darker_than_its_surround_is_not_used(scene: PlannedScene) -> None:
    dark = [replace(one, light_dn=200 - one.light_dn) for one in (view(scene, photo, TURN) for photo in range(3))]
    found = fit_facet(scene.facets[0], dark, scene.source, TURN)
    assert not found.turns
    assert dict(found.unused) == dict.fromkeys(range(3), Unused.DARKER)


def test_a_part_in_shade_is_light_that_no_turn_makes(scene: PlannedScene) -> None:
    def foreign(one: FacetView) -> bool:
        (found,) = fit(scene, [one]).turns
        return has_foreign_light(scene.facets[0], found, scene.source, 0.1e-3, BLUR_M)

    lit = view(scene, 0, TURN)
    bright = lit.light_dn > 90
    rows = lit.pixels.pixels_px[:, 1]
    shade = rows > np.median(rows[bright])
    assert not foreign(lit)
    assert foreign(replace(lit, light_dn=np.where(shade & bright, 12.0, lit.light_dn)))


@pytest.fixture(scope="module")
def exact(scene: PlannedScene) -> list[FacetFit]:
    """Return the fits of all facets, turned alike."""
    return [
        fit_facet(facet, [view(scene, photo, TURN, k) for photo in range(3)], scene.source, TURN)
        for k, facet in enumerate(scene.facets)
    ]


def adjusted(scene: PlannedScene, exact: list[FacetFit], off_rad: dict[tuple[int, int], FloatArray]) -> JointTurns:
    """Adjust photos that show the turn of each facet exactly but for what some facets are off in some photos."""
    stations = [
        replace(
            predicted_station(scene.camera, pose, scene.facets, 0.1, name),
            place_m=pose.inverse().translation_m,
            sigma_place_m=1e-3,
        )
        for name, pose in zip(scene.photos, scene.poses, strict=True)
    ]

    def fits(facet: Facet, moved: Sequence[Station], source: Source, start_rad: FloatArray | None) -> FacetFit:
        k = scene.facets.index(facet)
        shifted = []
        for one in exact[k].turns:
            state = one.state.copy()
            state[:2] += off_rad.get((k, one.view.photo), 0.0)
            shifted.append(replace(one, state=state))
        return FacetFit(shifted)

    return adjust(scene.camera, scene.facets, stations, scene.source, 1e-3, fits)


def test_a_photo_that_contradicts_the_others_is_left_out(scene: PlannedScene, exact: list[FacetFit]) -> None:
    rng = np.random.default_rng(0)
    off = {(k, photo): rng.normal(0, 5e-5, 2) for k in range(4) for photo in range(3)}
    assert not any(adjusted(scene, exact, off).unused)
    off[2, 1] = np.array([0.6e-3, 0.0])
    found = adjusted(scene, exact, off)
    assert [dict(one) for one in found.unused] == [{}, {}, {1: Unused.CONTRADICTS}, {}]
    assert np.abs(found.turns_rad - TURN).max() < 0.2e-3


def test_the_sigma_holds_that_waves_are_found_from_few_numbers(scene: PlannedScene, exact: list[FacetFit]) -> None:
    """JCGM 101:2008, 6.4.9.4: Student's distribution of n has a variance larger by n / (n - 2)."""
    rng = np.random.default_rng(0)
    found = adjusted(scene, exact, {(k, photo): rng.normal(0, 5e-4, 2) for k in range(4) for photo in range(3)})
    factor = found.redundancy / (found.redundancy - 2)
    assert 1.1 < factor < 1.3
    np.testing.assert_allclose(found.random_rad, found.wave_rad * np.sqrt(factor / 3), rtol=0.01)


def test_a_survey_places_a_camera_that_corners_do_not(scene: PlannedScene) -> None:
    """Corners with noise of 0.1 px leave a camera near the axis of a flat heliostat some decimetres open."""
    pose, camera = scene.poses[0], scene.camera
    truth = pose.inverse().translation_m
    exact = predicted_station(camera, pose, scene.facets, 0.1, "photo")
    noise = np.random.default_rng(3).normal(0, 0.1, exact.pixels_px.shape)
    alone = place_camera(camera, exact.points_m, exact.pixels_px + noise, 0.1, "photo")
    surveyed = replace(alone, place_m=truth, sigma_place_m=3e-3).settled(camera)
    assert np.linalg.norm(alone.cam_from_heliostat.inverse().translation_m - truth) > 0.1
    assert np.linalg.norm(surveyed.cam_from_heliostat.inverse().translation_m - truth) < 9e-3
