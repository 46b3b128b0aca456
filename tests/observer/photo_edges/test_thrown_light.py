"""Light that walls of glass throw back: none is lost, and it comes from where mirrors as round as these look to."""

import numpy as np
import pytest

from observer.photo_edges.thrown_light import thrown_light
from observer.photo_edges.tube_profile import through_glass
from observer.trough import ls2

DESIGN = ls2()
GLASS = DESIGN.glass
assert GLASS is not None
BESIDE = np.arange(-0.06, 0.06, 1e-4) + 5e-5


def thrown(eta_rad: float) -> np.ndarray:
    """Light from sky, ground and mirror, from smaller and from larger x, shape (3, 2, n)."""
    assert GLASS is not None
    down = np.sin(eta_rad), -np.cos(eta_rad)
    return np.array(thrown_light(DESIGN, GLASS, down, DESIGN.focal_length_m, BESIDE))


def test_what_does_not_pass_is_thrown_back() -> None:
    assert GLASS is not None
    beside_metal = (np.abs(BESIDE) > 0.036) & (np.abs(BESIDE) < 0.045)
    all_of_it = thrown(0.2).sum(axis=(0, 1)) + through_glass(GLASS, BESIDE).passed
    # Light that is reflected twice in one wall is not in what passes, ``2 r^2``, 0.004; three reflections, ``(2 r)^3``.
    np.testing.assert_allclose(all_of_it[beside_metal], 1.0, atol=0.006)


def test_seen_from_above_both_sides_are_alike() -> None:
    light = thrown(0.0)
    np.testing.assert_allclose(light, light[:, ::-1, ::-1], atol=1e-12)


@pytest.mark.parametrize("eta_deg", [10.0, 20.0, 25.0])
def test_the_horizon_stands_where_the_outer_face_turns_light_by_a_right_angle_less_eta(eta_deg: float) -> None:
    """``2 asin(b / r) = 90 deg - eta`` puts the horizon at b; at 15 degrees that is where the metal ends."""
    sky = thrown(np.radians(eta_deg))[0]
    # The camera is at smaller x: there the sky is on that side of the tube.
    assert GLASS is not None
    b = GLASS.outer_diameter_m / 2 * np.sin(0.5 * np.radians(90 - eta_deg))
    side = BESIDE < 0
    step = BESIDE[side][np.argmax(np.diff(sky[0][side]))]
    assert step == pytest.approx(-b, abs=0.3e-3)
