"""Doubts that a more serious one explains are left out; others stay in their order."""

from heliogauge.doubts import Doubt
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
