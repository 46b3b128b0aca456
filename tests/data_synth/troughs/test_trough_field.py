"""Several troughs in one photo: each is as it is alone, and its truth is in its own frame."""

import numpy as np
import pytest

from data_synth.troughs.dataset import observer_content
from data_synth.troughs.field import FieldTracer, single_of
from data_synth.troughs.mirror import Rays
from data_synth.troughs.presets import ROW_STEP_M, TroughChoice, trough_scene
from data_synth.troughs.trace import Tracer
from heliogauge.errors import InputError


def rays_down(x_m: np.ndarray, y_m: np.ndarray, from_x_m: float) -> Rays:
    """Return rays from one eye at 12 m to points at the height of half a trough."""
    eye = np.tile([[from_x_m], [0.0], [12.0]], x_m.size)
    return Rays(*eye, x_m - eye[0], y_m - eye[1], 0.8 - eye[2])


@pytest.mark.slow
def test_each_trough_looks_as_it_does_alone() -> None:
    scene = trough_scene("flight", TroughChoice(3, 2, is_shaped=True))
    field = FieldTracer(scene.troughs, np.float64)
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-3.3, 3.3, 60), np.linspace(-2.0, 2.0, 40)))
    for one in scene.troughs:
        alone = Tracer(one.world, np.float64).look(rays_down(x, y, 1.7))
        among = field.look(rays_down(x + one.place_m[0], y, 1.7 + one.place_m[0]))
        np.testing.assert_allclose(among.light, alone.light, atol=1e-6)
    # Ground goes on where one trough's part of the field ends.
    edge = ROW_STEP_M / 2
    left, right = (field.look(rays_down(np.full(9, edge + way), np.linspace(-1, 1, 9), edge)) for way in (-1e-6, 1e-6))
    np.testing.assert_allclose(left.light, right.light, atol=1e-4)
    np.testing.assert_array_equal(left.label, right.label)


def test_a_trough_hides_what_is_behind_it() -> None:
    scene = trough_scene("flight", TroughChoice(3, 2))
    field = FieldTracer(scene.troughs, np.float64)
    points = np.array([[ROW_STEP_M, 0.0, -1.0], [ROW_STEP_M / 2, 0.0, -1.0]])
    assert field.hides(np.array([ROW_STEP_M, 0.5, 12.0]), points).tolist() == [True, False]


def test_the_folder_tells_where_modules_are_and_each_ones_truth() -> None:
    scene = trough_scene("flight", TroughChoice(3, 2))
    content = observer_content(scene, ".png")
    assert [one["place_m"][0] for one in content["module"]] == [0.0, ROW_STEP_M]
    # A tape between rows was not laid.
    assert "scale_bar" not in content
    second = single_of(scene, scene.troughs[1])
    places = np.array([sheet.world_from_sheet.translation_m for sheet in second.sheets])
    assert np.abs(places[12:, 0]).max() < 3.0
    np.testing.assert_allclose(second.views[0].position_m, scene.views[0].position_m - [ROW_STEP_M, 0, 0], atol=1e-12)
    x, z = second.world.receiver.position_m(np.zeros(1))
    np.testing.assert_allclose([*x, *z], [2e-3, 1.486])


def test_one_map_of_slopes_for_two_troughs_is_refused() -> None:
    with pytest.raises(InputError, match="several troughs"):
        trough_scene("flight", TroughChoice(0, 2, orientation_deg=20.0))
