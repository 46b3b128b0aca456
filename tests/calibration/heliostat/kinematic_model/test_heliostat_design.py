"""Parameters, chains and targets: what they say of themselves, and what they refuse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.heliostat.kinematic_model.design import (
    Driven,
    DriveTerms,
    HeliostatDesign,
    PlaneTarget,
    RotaryDrive,
    Shift,
    Turn,
)
from calibration.heliostat.kinematic_model.parameters import FREE, HELD, Parameters
from heliogauge.errors import InputError

TABLE = {
    "position_e": (1.0, "m"),
    "position_n": (2.0, "m"),
    "position_u": (3.0, "m"),
    "tilt_north": (0.0, "rad"),
    "azimuth_offset": (0.0, "rad"),
    "elevation_offset": (0.0, "rad"),
}
STEPS = (
    Shift(("position_e", "position_n", "position_u")),
    Turn((-2.0, 0.0, 0.0), "tilt_north"),
    Driven((0.0, 0.0, -1.0), 0),
    Driven((1.0, 0.0, 0.0), 1),
)


def design(**changes):
    fields = {
        "name": "A1",
        "steps": STEPS,
        "drives": (RotaryDrive("azimuth_offset"), RotaryDrive("elevation_offset")),
        "normal": (0.0, 1.0, 0.0),
        "parameters": Parameters.of(TABLE),
        "limits": [[-np.pi, np.pi], [0.0, np.pi / 2]],
        "free_sets": {"tilt": ("tilt_north",)},
    }
    return HeliostatDesign(**(fields | changes))


def test_parameters_change_by_name_and_stay_what_they_were():
    before = Parameters.of(TABLE)
    after = before.with_value({"tilt_north": 1e-3}).with_sigmas({"tilt_north": FREE, "position_u": 0.1})
    assert after.value("tilt_north") == 1e-3
    assert after.free_names == ("position_u", "tilt_north")
    assert after.sigma("position_e") == HELD
    assert before.value("tilt_north") == 0.0
    assert before.free.sum() == 0
    only = after.with_only_free(["azimuth_offset"], sigma=2e-3)
    assert only.free_names == ("azimuth_offset",)
    assert only.sigma("azimuth_offset") == 2e-3
    longer = before.extended(Parameters.of({"camera_e": (5.0, "m")}))
    assert longer.index("camera_e") == len(before)
    with pytest.raises(ValueError, match="read-only"):
        after.values[0] = 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Parameters.of(TABLE).index("tilt_nort"), "did you mean tilt_north"),
        (lambda: Parameters.of(TABLE).with_value({"xyz": 1.0}), "no such parameter; there are position_e"),
        (lambda: Parameters(("a", "a"), [1, 2], [0, 0], ("m", "m")), "a occur more than once"),
        (lambda: Parameters(("a", "b"), [1, 2], [0, -1], ("m", "m")), "sigma of b must be 0"),
        (lambda: Parameters(("a", "b"), [1, 2], [0, np.nan], ("m", "m")), "sigma of b must be 0"),
        (lambda: Parameters(("a",), [1], [0], ("m", "m")), "1 names and 2 units"),
        (lambda: Parameters(("a",), [np.nan], [0], ("m",)), "not finite"),
        (lambda: design(steps=STEPS[:3]), "drives 0 and 1 must occur once"),
        (lambda: design(steps=(*STEPS, Turn((1, 0, 0), "tilt_nrth"))), "did you mean tilt_north"),
        (lambda: design(limits=[[1, -1], [0, 1]]), "lowest and highest"),
        (lambda: design(reading_unit="deg"), "counts or rad"),
        (lambda: design(free_sets={"4": ("tilt_noth",)}), "did you mean tilt_north"),
        (lambda: design().with_free("8"), "no choice of free parameters '8'; known: tilt"),
        (lambda: Turn((0, 0, 0), "tilt"), "length zero"),
        (lambda: Driven((0, 0, 1), 2), "drive 0 or 1"),
        (lambda: Shift((None, None, "a"), 2.0), "sign of"),
        (lambda: RotaryDrive("a", rad_per_reading=0.0), "other than 0"),
        (lambda: DriveTerms(worm=("a",)), "no, two or four"),
        (lambda: DriveTerms(worm=("a", "b")), "worm_ratio"),
        (lambda: PlaneTarget("t", (0, 0, 0), (1, 0, 0), (1, 0, 1), 1, 1), "perpendicular"),
        (lambda: PlaneTarget.facing("t", (0, 0, 0), 0.0, -1, 1), "width_m"),
        (lambda: PlaneTarget.from_corners("t", [[0, 0, 1], [1, 0, 0], [1, 0, 1], [0, 0, 0]]), "upper left, upper"),
    ],
)
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_design_says_what_its_chain_uses_and_what_is_free():
    heliostat = design()
    assert heliostat.used_names == (*TABLE,)
    np.testing.assert_array_equal(heliostat.position_m, [1.0, 2.0, 3.0])
    assert heliostat.with_free("tilt").parameters.free_names == ("tilt_north",)
    assert heliostat.with_free(("position_u",)).parameters.free_names == ("position_u",)
    assert heliostat.with_value({"position_u": 7.0}).position_m[2] == 7.0
    np.testing.assert_array_equal(STEPS[1].axis, [-1.0, 0.0, 0.0])


@given(azimuth=st.floats(-4, 8), x=st.floats(-5, 5), y=st.floats(-5, 5))
def test_target_coordinates_and_back(azimuth, x, y):
    target = PlaneTarget.facing("t", (3.0, -2.0, 40.0), azimuth, 4.0, 6.0)
    point = target.points([[x, y]])
    np.testing.assert_allclose(target.coordinates(point), [[x, y]], atol=1e-12)
    np.testing.assert_allclose(target.normal, [np.sin(azimuth), np.cos(azimuth), 0], atol=1e-15)
    # Off the plane by a metre: the same coordinates.
    np.testing.assert_allclose(target.coordinates(point + target.normal), [[x, y]], atol=1e-12)
    assert target.contains([[x, y]])[0] == (abs(x) <= 2 and abs(y) <= 3)


def test_a_target_facing_south_has_east_on_the_right_and_one_facing_north_west():
    south = PlaneTarget.facing("s", (0, 0, 0), np.pi, 1, 1)
    north = PlaneTarget.facing("n", (0, 0, 0), 0.0, 1, 1)
    np.testing.assert_allclose(south.right, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(north.right, [-1, 0, 0], atol=1e-15)


def test_target_from_corners_is_the_plane_they_lie_in():
    made = PlaneTarget.facing("t", (3.0, -2.0, 40.0), 2.9, 4.0, 6.0)
    corners = made.points([[-2, 3], [2, 3], [2, -3], [-2, -3]])
    found = PlaneTarget.from_corners("t", corners)
    for name in ("center_m", "right", "up", "width_m", "height_m"):
        np.testing.assert_allclose(getattr(found, name), getattr(made, name), atol=1e-12)
    assert found.flatness_m < 1e-12
    # One corner 8 mm out of the plane is a twist of 2 mm at each.
    corners = corners.copy()
    corners[0] += 8e-3 * made.normal
    assert PlaneTarget.from_corners("t", corners).flatness_m == pytest.approx(2e-3, rel=1e-4)
