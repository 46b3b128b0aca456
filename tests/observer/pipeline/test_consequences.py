"""Doubts that a more serious one explains are left out; others stay in their order."""

import pytest

from heliogauge.doubts import Doubt, Severity
from observer.pipeline.judgement import without_consequences


def codes(*given: str) -> list[str]:
    return [one.code for one in without_consequences(tuple(Doubt(code, code) for code in given))]


def test_a_wrong_focal_length_explains_heights_and_shape() -> None:
    cause, other = "focal_length_contradicts_photos", "photos_missing"
    heights, shape = "panel_heights_contradict_reflection", "surface_shape_undecided"
    assert codes(heights, other, cause, shape) == [other, cause]
    assert codes(heights, other, shape) == [heights, other, shape]


def test_forgotten_glass_explains_the_width_of_the_tube() -> None:
    wide = "absorber_diameter_contradicts_reflection"
    assert codes(wide, "absorber_diameter_contradicts_photos", "glass_not_stated") == ["glass_not_stated"]
    assert codes(wide, "absorber_diameter_contradicts_photos") == [wide]


def test_a_wrong_camera_or_list_explains_single_places_but_no_scale_bar() -> None:
    place, bar = "known_place_contradicts", "known_value_contradicts"
    for cause in ("camera_contradicts_targets", "focal_length_contradicts_targets", "targets_contradict_list"):
        assert codes(place, bar, cause) == [bar, cause]
    for camera in ("camera", "focal_length", "principal_point"):
        cause = f"{camera}_contradicts_targets"
        assert codes(place, bar, "targets_contradict_list", cause) == [bar, cause]
    assert codes(place, bar) == [place, bar]


def test_a_list_beside_the_mirror_explains_heights_of_panels() -> None:
    assert codes("panel_heights_contradict_reflection", "list_beside_mirror") == ["list_beside_mirror"]


@pytest.mark.parametrize("cause", ["list_beside_mirror", "stated_absorber_contradicts_photos"])
def test_a_cause_that_hardly_moves_slopes_hides_nothing_serious(cause: str) -> None:
    shape = Doubt("surface_shape_contradicts_reflection", "shape", severity=Severity.SERIOUS)
    for severity, left in ((Severity.DOUBT, [cause, shape.code]), (Severity.SERIOUS, [cause])):
        given = (Doubt(cause, "beside", severity=severity), shape)
        assert [one.code for one in without_consequences(given)] == left
