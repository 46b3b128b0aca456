"""Nights before the tower to draw and the errors of what was measured, for tests and benchmark."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_synth.fringes import DatasetOptions, FringeScene, read_truth, write_dataset
from data_synth.fringes.tower import SIGMA_PLACE_MM, UNAM_SIGMA_RAD, tower_knowledge, tower_scene, unam_scene
from data_synth.fringes.truth import FringeTruth
from deflectometry.pipeline.result import Result


@dataclass(frozen=True)
class TowerErrors:
    """Errors against the truth [rad].

    inside: RMS of the slopes beside each facet's mean, both directions.
    canting: Largest error of a facet's mean slope beside the mean of all.
    normal_cam, normal_screen (2,): Of the mean normal, x and y in the camera's frame and in the screen's.
    """

    inside: float
    canting: float
    normal_cam: np.ndarray
    normal_screen: np.ndarray


def tower_errors(result: Result, scene: FringeScene, truth: FringeTruth) -> TowerErrors:
    """Compare slopes, canting and mean normal with the truth."""
    inside, means, normals = [], [], []
    for number, facet in enumerate(truth.facets):
        image = result.evaluation.images[facet.name]
        seen = np.isfinite(image.slope_x)
        true = np.stack(truth.slopes(image.x_m[seen], image.y_m[seen], facet=number))
        found = np.stack([image.slope_x[seen], image.slope_y[seen]])
        means.append((found - true).mean(axis=1))
        inside.append(np.mean((found - true - means[-1][:, None]) ** 2))
        for pose, slopes in ((result.evaluation.solution.cam_from_mirror, found), (scene.bench.cam_from_mirror, true)):
            normals.append(pose.rotate(facet.mirror_from_facet.rotate(np.array([*-slopes.mean(axis=1), 1.0]))))
    found, true = np.mean(normals[::2], axis=0), np.mean(normals[1::2], axis=0)
    in_screen = result.setup.cam_from_screen.rotation.T @ found - scene.bench.cam_from_wall.rotation.T @ true
    return TowerErrors(
        float(np.sqrt(np.mean(inside))),
        float(np.abs(np.array(means) - np.mean(means, axis=0)).max()),
        (found - true)[:2],
        in_screen[:2],
    )


def draw_night(folder: Path, scale: float, seed: int) -> None:
    """Draw a heliostat before its tower, its place surveyed."""
    knowledge = tower_knowledge(scale, sigma_place_mm=SIGMA_PLACE_MM)
    write_dataset(folder, tower_scene(scale=scale), DatasetOptions(seed, knowledge))


def draw_unam(folder: Path) -> tuple[float, float]:
    """Draw UNAM's bent facet; return its published deviations from a plane [rad]."""
    write_dataset(folder, unam_scene(), DatasetOptions(1, tower_knowledge(sigma_place_mm=SIGMA_PLACE_MM)))
    return UNAM_SIGMA_RAD


def night_errors(result: Result, folder: Path, scale: float) -> TowerErrors:
    """Compare a night that `draw_night` drew with its truth."""
    return tower_errors(result, tower_scene(scale=scale), read_truth(folder))
