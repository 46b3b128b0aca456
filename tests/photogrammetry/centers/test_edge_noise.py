"""Sigmas of centres where neighbouring pixels err alike (the beat of a display, a soft noise), and where not."""

import cv2
import numpy as np
import pytest

from photogrammetry.centers.disc_model import disc_model
from photogrammetry.centers.edge_noise import variance_factor
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.centers.measured_centers import measure_centers
from photogrammetry.centers.target_center import TargetCenter


def independent(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return rng.normal(0, 2.0, shape)


def beat(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Two waves of 9 px, and independent noise."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    turn, start = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi, 2)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    waves = np.cos(2 * np.pi / 9 * along + start[0]) + np.cos(2 * np.pi / 9 * across + start[1])
    return 8 * waves + rng.normal(0, 0.5, shape)


def soft(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Noise that neighbours within some 2 px share, as after demosaicing or JPEG."""
    return cv2.GaussianBlur(rng.normal(0, 12.0, shape), (0, 0), 1.5)


@pytest.mark.parametrize(
    ("noise", "alone", "factor"),
    [(independent, (0.7, 1.4), (1.0, 1.35)), (beat, (3, 12), (3, 12)), (soft, (3, 20), (3, 20))],
)
def test_centres_err_as_is_said(noise, alone, factor) -> None:
    """Chi-square over its freedom: of independent pixels by themselves, and times the factor of a photo's targets."""
    rng = np.random.default_rng(5)
    raw, told, factors = [], [], []
    for _ in range(4):
        image = 190 + noise(rng, (480, 480))
        starts, places = [], []
        for x in range(40, 480, 80):
            for y in range(40, 480, 80):
                place, radius = np.array([x, y]) + rng.uniform(-0.5, 0.5, 2), rng.uniform(9, 18)
                form = np.diag([radius**2, (0.8 * radius) ** 2])
                parameters = np.array([*(place - [x, y]), 1 / radius, 0, 1.25 / radius, 0.67, 0, 0, 0, -150, 0, 0])
                rows, columns = np.mgrid[-40:40, -40:40]
                values, _ = disc_model(parameters, columns.ravel(), rows.ravel())
                image[y - 40 : y + 40, x - 40 : x + 40] += values.reshape(80, 80)
                starts.append(Ellipse(place, form))
                places.append(place)
        found = [one for one in measure_centers(image, starts) if isinstance(one, TargetCenter)]
        assert len(found) == len(places)
        off = np.array([one.center_px for one in found]) - places
        covariance = np.array([one.covariance_px2 for one in found])
        square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off) / 2
        factors.append(variance_factor(np.array([one.edge_powers for one in found])))
        raw.append(square.mean())
        told.append(square.mean() / factors[-1])
    assert alone[0] < np.mean(raw) < alone[1]
    assert factor[0] <= np.mean(factors) < factor[1]
    assert 0.7 < np.mean(told) < 1.35
