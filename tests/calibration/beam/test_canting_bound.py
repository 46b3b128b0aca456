"""What photos can tell of the canting at best: the Cramer-Rao bound of the pixels' noise alone, many facets.

The docs quote these numbers (`pytest -m slow -s` prints them); nothing of the estimator's covariance is in them.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
import pytest

from calibration.beam.exchange.surfaces import design_mirror
from calibration.beam.keys import BeamFacetSection
from calibration.beam.mirror.expected_flux import FluxGrid, whole_flux
from calibration.beam.mirror.facets import canted
from calibration.beam.mirror.flux_fit import FluxPhoto, MirrorStand, flux_information
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.geometry.target_planes import PlaneTarget
from heliogauge.sunlight.sun_shapes import BuieSun

#: Noise of a photo's pixel over the beam's peak (1.5 DN of 170, two thirds of 8 bits), and pixels across the target.
_NOISE_SHARE, _PIXELS = 1.5 / 170, 245
_SITE = Site(37.094, -2.358, 500.0)


def suns(*days: str) -> npt.NDArray[np.float64]:
    """Three suns of each day."""
    times = [f"2025-{day}T{hour:02d}:30" for day in days for hour in (9, 12, 15)]
    return np.asarray(sun_directions(np.array(times, dtype="datetime64[ms]"), _SITE))


def told_by_suns(
    facets: tuple[int, int], size_m: tuple[float, float], distance_m: float, suns: npt.NDArray[np.float64]
) -> list[npt.NDArray[np.float64]]:
    """Return what one frame at each sun tells of canting, curvature and scatter, as Fisher information."""
    rng = np.random.default_rng(0)
    width, height = size_m[0] / facets[0], size_m[1] / facets[1]
    k = facets[0] * facets[1]
    x = (np.arange(facets[0]) - 0.5 * (facets[0] - 1)) * width
    y = (np.arange(facets[1]) - 0.5 * (facets[1] - 1)) * height
    centers = np.stack([*(one.ravel() for one in np.meshgrid(x, y)), np.zeros(k)], axis=1)
    turns = 0.8e-3 * rng.standard_normal((k, 2))
    mirror = design_mirror(
        tuple(
            BeamFacetSection(
                center_m=tuple(one.tolist()),
                width_m=0.98 * width,
                height_m=0.98 * height,
                focal_length_m=distance_m,
                canting_mrad=tuple((-1e3 * one[:2] / (2 * distance_m)).tolist()),
            )
            for one in centers
        )
    )
    up = min(38.0, 0.5 * distance_m)
    stand = MirrorStand(np.array([0.14 * distance_m, np.sqrt(0.98 * distance_m**2 - up**2), 2.0]), "azimuth-elevation")
    half = 5e-3 * distance_m + 1.2 * float(np.hypot(*size_m))
    target = PlaneTarget.facing("white", np.array([0.0, 0.0, 2.0 + up]), 0.0, 2 * half, 2 * half)
    step = 4.65e-3 * distance_m / 5
    axis = np.arange(-half, half, step)
    grid = FluxGrid(axis, axis)
    fit = SimpleNamespace(canting_rad=turns - turns.mean(axis=0), curvature_1pm=0.0, scatter_rad=1.6e-3)
    told = []
    for sun in suns:
        photo = FluxPhoto("drawn", target, sun, grid, np.zeros(grid.shape), np.zeros(2), BuieSun(0.02))
        light = whole_flux(photo.scene(stand, np.zeros(2), 1.6e-3), canted(mirror, fit.canting_rad), grid)
        photo = replace(photo, flux_dn=100 * light / light.max())
        # Residuals are shares of the RMS flux over the root of the pixels' number; a pixel of the grid joins some of
        # the photo's.
        share = _NOISE_SHARE * light.max() / np.sqrt(np.mean(light**2)) * (2 * half / _PIXELS) / step
        told.append(flux_information(photo, mirror, stand, fit) * grid.x_m.size**2 / share**2)
    return told


def least_sigma_mrad(told: list[npt.NDArray[np.float64]], prior_rad: float | None = None) -> float:
    """Return the Cramer-Rao bound of a facet's canting, RMS, from the pixels' noise alone [mrad].

    No estimator without knowledge beforehand does better; with a prior it is the bound of a Bayesian one. Curvature,
    scatter, aim, brightness and level of each photo are estimated beside it.
    """
    total = np.sum(told, axis=0)
    count = len(total) - 2
    if prior_rad is not None:
        total = total + np.diag([prior_rad**-2] * count + [0.0, 0.0])
    values = np.linalg.eigvalsh(total)
    covariance = np.linalg.pinv(total, hermitian=True, rcond=1e-14)[:count, :count]
    exact = values[0] > 1e-12 * values[-1]
    return 1e3 * float(np.sqrt(np.trace(covariance) / (count + 2))) if exact else float("inf")


SMALL, LARGE = ((5, 5), (3.2, 2.6)), ((5, 5), (8.0, 8.0))
SPRING, SEASONS = ("03-20",), ("03-20", "06-21", "12-21")


@pytest.mark.slow
@pytest.mark.parametrize(("mirror", "distance_m"), [(SMALL, 66.0), (LARGE, 66.0), (LARGE, 150.0), (LARGE, 400.0)])
def test_three_suns_of_a_day_do_not_tell_25_facets(
    mirror: tuple[tuple[int, int], tuple[float, float]], distance_m: float
) -> None:
    """One frame of 8 bits at each of three suns leaves more than 0.1 mrad, whatever estimates; three seasons do not."""
    told = told_by_suns(*mirror, distance_m, suns(*SEASONS))
    three, nine = least_sigma_mrad(told[:3]), least_sigma_mrad(told)
    known = least_sigma_mrad(told[:3], prior_rad=0.8e-3)
    print(f"{mirror} at {distance_m:g} m: {three:.3f} mrad, with a prior {known:.3f}, nine suns {nine:.3f}")
    assert three > 0.2
    assert 0.2 < known < min(three, 0.8)
    assert nine < 0.15 < three


@pytest.mark.slow
def test_four_facets_are_told_by_three_suns() -> None:
    """Their noise alone leaves 0.02 mrad; drawn photos with panels and seams give 0.05."""
    assert least_sigma_mrad(told_by_suns((2, 2), (3.2, 2.6), 66.0, suns(*SPRING))) < 0.05
