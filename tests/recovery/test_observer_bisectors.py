"""The absorber behind glass in drawn photos, from their true poses: where the bisectors of single photos put it."""

import numpy as np
import pytest

from data_synth.troughs.photo import Photographer
from data_synth.troughs.presets import TroughChoice, trough_scene
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from observer.photo_edges.tube_bearings import bearing, tube_bearings
from observer.photo_edges.views import Shot, View
from observer.trough import AbsorberPath, Expectation

#: Photos of a pass of sixty, from both sides, away from the tube's reflection.
PHOTOS = (0, 8, 53, 59)


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "seed"), [("clouds", 0), ("clouds", 1), ("ls2", 0)])
def test_bisectors_give_the_height_of_a_tube_in_glass(preset: str, seed: int) -> None:
    scene = trough_scene(preset, TroughChoice(seed=seed, n_photos=60)).scaled(0.6)
    photographer, drawn = Photographer(scene), scene.camera
    lens = BrownDistortion(drawn.k1, drawn.k2, drawn.k3, drawn.p1, drawn.p2)
    names = ("width_px", "height_px", "focal_x_px", "focal_y_px", "center_x_px", "center_y_px")
    camera = Camera(*(getattr(drawn, name) for name in names), distortion=lens)
    y = scene.collector.rows_m(0.02)
    expected = Expectation(scene.collector, AbsorberPath.designed(scene.collector), y)
    columns, off = [], []
    for number in PHOTOS:
        view = scene.views[number]
        image = photographer.take(view, np.random.default_rng([seed, number])).astype(np.float32)
        found = tube_bearings([Shot(image, number, View(camera, view.cam_from_trough))], expected)[0]
        assert found.y_m.size > 250
        x, z = scene.world.receiver.position_m(found.y_m)
        eyes = np.tile(view.position_m, (found.y_m.size, 1))
        true = bearing(x, z, eyes)
        distance = np.hypot(eyes[:, 0] - x, eyes[:, 2] - z)
        columns.append([np.mean(np.cos(true) / distance), np.mean(np.sin(true) / distance)])
        off.append(float(np.median(found.angle_rad - true)))
        # Within what photos are taken to err together.
        assert abs(off[-1]) < 2 * float(np.median(found.shared_rad))
    place = np.linalg.lstsq(np.array(columns), np.array(off), rcond=None)[0]
    # 0.02 px on one side and the other are 1.1 mm; the error of one photo is independent of the next one's.
    assert abs(place[0]) < 0.3e-3
    assert abs(place[1]) < 0.8e-3
