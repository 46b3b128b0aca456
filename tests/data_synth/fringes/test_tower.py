"""The heliostat seen from its tower: it fills its photo, and a facet that is turned too far looks past the target."""

import numpy as np

from data_synth.fringes.tower import tower_scene


def _seen(turned_away_rad: float) -> list[float]:
    """Share of each facet's outline in which the target is seen."""
    scene = tower_scene(scale=0.2, turned_away_rad=turned_away_rad)
    shares = []
    for facet in scene.facets:
        outline = scene.bench.project_outline(facet)
        camera = scene.bench.camera
        assert ((outline > 1) & (outline < np.array([camera.width_px, camera.height_px]) - 2)).all()
        seen = scene.bench.trace(facet, outline[:, 0], outline[:, 1])
        shares.append(float(np.mean((np.abs(seen.u - 0.5) <= 0.5) & (np.abs(seen.v - 0.5) <= 0.5))))
    return shares


def test_all_facets_of_the_sound_heliostat_show_the_target() -> None:
    assert _seen(0.0) == [1.0] * 9


def test_a_facet_turned_by_25_mrad_looks_past_it() -> None:
    """The target spans 17 mrad of slope across (C-23): twice 25 mrad at 201 m are 10 m."""
    shares = _seen(25e-3)
    assert shares[:8] == [1.0] * 8
    assert shares[8] == 0.0
