"""Several facets in one photo of dots: errors of all of them together against the covariance that the maps state.

The photos are traced by `data_synth`, which shares no equation with the estimator; set-ups are stated with errors.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.dots import DotScene, dot_scene, write_dot_dataset
from data_synth.fringes.dataset import DatasetOptions
from data_synth.fringes.knowledge import Knowledge
from deflectometry.dots.keys import load_dots
from deflectometry.dots.pipeline.measure import run
from deflectometry.pipeline.result import Result
from heliogauge.validate import FloatArray
from tests.deflectometry.dots.known_dots import known_dots

pytestmark = pytest.mark.slow

_SEEDS = 10
_KNOWLEDGE = Knowledge(
    sigma_distance_mm=2.0,
    sigma_screen_rotation_mrad=0.3,
    sigma_screen_translation_mm=2.0,
    sigma_focal_px=1.0,
    sigma_center_px=1.0,
)


def _scene() -> DotScene:
    """Return three facets of the ensemble, two beside each other and one across a corner."""
    drawn = dot_scene("ensemble", "light")
    facets = tuple(drawn.scene.facets[k] for k in (0, 1, 5))
    return replace(drawn, marked=False, scene=replace(drawn.scene, facets=facets))


def _errors(result: Result, scene: DotScene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return tilt and gradients of the slope errors of all facets, their covariance, and the dots' errors in sigma."""
    found, random, modes, rest = [], [], [], []
    for facet in scene.scene.facets:
        image, common = result.evaluation.images[facet.name], result.evaluation.maps[facet.name].common
        seen = np.isfinite(image.slope_x)
        x, y = image.x_m[seen], image.y_m[seen]
        _, *true = facet.surface(x, y)
        terms = np.column_stack([np.ones(x.size), x, y])
        along = common.evaluate(x, y)
        measured = (image.slope_x, image.sigma_x), (image.slope_y, image.sigma_y)
        for axis, (slope, sigma) in enumerate(measured):
            own = sigma[seen].astype(np.float64)
            solver = np.linalg.pinv(terms / own[:, None])
            error = (slope[seen] - true[axis]) / own
            found.append(solver @ error)
            rest.append(error - (terms / own[:, None]) @ found[-1])
            random.append(solver @ solver.T)
            modes.append((along[:, axis] / own) @ solver.T)
    covariance = np.concatenate(modes, axis=1).T @ np.concatenate(modes, axis=1)
    for k, one in enumerate(random):
        covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += one
    return np.concatenate(found), covariance, np.concatenate(rest)


def test_errors_of_all_facets_together_are_as_large_as_their_covariance_says(tmp_path: Path) -> None:
    scene = _scene()
    stated = {"pattern": {"dots": "dark", "known_dot": known_dots(scene)}}
    chi_squares, rests = [], []
    for seed in range(_SEEDS):
        folder = tmp_path / str(seed)
        write_dot_dataset(folder, scene, DatasetOptions(seed=seed, knowledge=_KNOWLEDGE, stated=stated))
        result = run(load_dots(folder))
        assert not {one.code for one in result.doubts} & {"slopes_of_no_surface", "setup_contradicts_slopes"}
        error, covariance, rest = _errors(result, scene)
        # The alignment takes the mean tilt out of both; its direction says nothing.
        mean = np.zeros((2, error.size))
        for axis in range(2):
            mean[axis, 3 * axis :: 6] = 1.0
        keep = np.linalg.svd(mean)[2][2:]
        left, spread = keep @ error, keep @ covariance @ keep.T
        chi_squares.append(float(left @ np.linalg.solve(spread, left)) / left.size)
        rests.append(np.mean(rest**2))
    assert 0.8 < np.sqrt(np.mean(chi_squares)) < 1.25
    assert 0.8 < np.sqrt(np.mean(rests)) < 1.25
