"""Which suns tell the canting of a mirror from photos of its beam, and how well, by the information of the fit.

Each sun has an information matrix of canting, curvature and scatter, the photo's aim and brightness taken out
(`flux_information`). What is left between measured and expected flux in a trial says what a unit of information is
worth: its covariance over that of white noise of variance one. Of it the noise of the pixels is averaged by more frames
of one sun; what the model lacks is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.beam.mirror.expected_flux import FluxGrid, whole_flux
from calibration.beam.mirror.facets import Mirror, canted, curved
from calibration.beam.mirror.flux_fit import FluxFit, FluxPhoto, MirrorStand, flux_information, zero_mean_basis
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray

__all__ = ["ChosenSun", "Trial", "choose_suns", "photo_of_sun", "trial_of"]

#: Second differences of white noise in both directions have 36 times its variance.
_SECOND = np.array([1.0, -2.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What a trial says of a unit of information.

    variance: Of the canting, over that of white noise of variance one.
    noise: The part of it that the noise of the pixels has: it is averaged by frames.
    facets: How many the mirror has.
    """

    variance: float
    noise: float
    facets: int

    def sigma_rad(self, information: FloatArray, frames: int = 1) -> float:
        """Return the sigma of a canting, RMS over the facets and both directions; infinite where not determined.

        information (p, p): Sum over the suns.
        frames: Photos at each sun.
        """
        worth = self.variance - self.noise + self.noise / frames
        return float(np.sqrt(worth)) * _unit_sigma(information, self.facets)

    def frames_for(self, information: FloatArray, wanted_rad: float) -> int | None:
        """Return the frames at each sun that give a sigma; None where no number does."""
        unit = _unit_sigma(information, self.facets) ** 2
        left = wanted_rad**2 / unit - (self.variance - self.noise) if np.isfinite(unit) else -1.0
        return int(np.ceil(max(self.noise, 1e-300) / left)) if left > 0 else None


@dataclass(frozen=True, slots=True, eq=False)
class ChosenSun:
    """A sun, and the information of it and of those chosen before.

    number: Of the sun in the list it was chosen from.
    information (p, p): Of all up to it.
    """

    number: int
    information: FloatArray


def _unit_sigma(information: FloatArray, facets: int) -> float:
    """Sigma of a canting for white noise of variance one, RMS over all facets; infinite where not determined."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return float("inf")
    scaled = information / scale[:, None] / scale
    if np.linalg.eigvalsh(scaled)[0] < 1e-8:
        return float("inf")
    covariance = np.linalg.inv(scaled) / scale[:, None] / scale
    half = 2 * (facets - 1)
    spread = np.kron(zero_mean_basis(facets), np.eye(2))
    return float(np.sqrt(np.trace(spread @ covariance[:half, :half] @ spread.T) / (2 * facets)))


def trial_of(fit: FluxFit, photos: Sequence[FluxPhoto], mirror: Mirror, stand: MirrorStand) -> Trial:
    """Say what a unit of information is worth by a fit.

    photos: Those of the fit.
    EstimationError: They do not determine the canting at all.
    """
    information = np.sum([flux_information(one, mirror, stand, fit) for one in photos], axis=0)
    unit = _unit_sigma(information, len(mirror.facets))
    if not np.isfinite(unit):
        raise EstimationError(
            f"the {len(photos)} photos of the trial do not tell the canting of {len(mirror.facets)} facets apart: take "
            "a trial at two or three suns some hours apart"
        )
    variance = float(np.mean(np.diag(fit.covariance_canting))) / unit**2
    noises = []
    for photo, expected in zip(photos, fit.expected_dn, strict=True):
        left = np.where(np.isfinite(photo.flux_dn), photo.flux_dn - expected, np.nan)
        second = np.apply_along_axis(np.convolve, 1, np.apply_along_axis(np.convolve, 0, left, _SECOND), _SECOND)
        inner = second[2:-2, 2:-2]
        scale = float(np.sqrt(np.nanmean(expected**2) * np.isfinite(photo.flux_dn).sum()))
        noises.append(float(np.nanmean(inner**2)) / 36 / scale**2)
    return Trial(variance, min(float(np.mean(noises)), variance), len(mirror.facets))


def photo_of_sun(like: FluxPhoto, to_sun: FloatArray, mirror: Mirror, stand: MirrorStand, fit: FluxFit) -> FluxPhoto:
    """Return the photo of another sun as the fitted mirror would make it, aimed at the middle of the target.

    like: A photo of the trial: target, size of its pixels, sun shape.
    to_sun (3,): The sun.
    InputError: The sun stands behind the mirror or below the horizon.
    EstimationError: The mirror sends no light to the target.
    """
    aim, step = np.zeros(2), like.grid.step_m
    half = 0.5 * np.array([like.target.width_m, like.target.height_m])
    axes = [np.arange(-one, one, step) for one in half]
    photo = FluxPhoto(like.name, like.target, to_sun, FluxGrid(axes[0], axes[1]), np.zeros(0), aim, like.sun)
    adjusted = canted(curved(mirror, fit.curvature_1pm), fit.canting_rad)
    flux = whole_flux(photo.scene(stand, aim, fit.scatter_rad), adjusted, photo.grid)
    lit = flux > 1e-3 * flux.max()
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    inner = np.ix_(np.arange(rows[0], rows[-1] + 1), np.arange(columns[0], columns[-1] + 1))
    grid = FluxGrid(axes[0][columns[0] : columns[-1] + 1], axes[1][rows[0] : rows[-1] + 1])
    return FluxPhoto(like.name, like.target, to_sun, grid, flux[inner], aim, like.sun)


def choose_suns(informations: Sequence[FloatArray], facets: int, most: int) -> list[ChosenSun]:
    """Choose suns one after the other, each the one that makes the canting's sigma smallest.

    informations (p, p): Of each sun.
    most: How many at most.
    InputError: No sun.
    """
    if not informations:
        raise InputError("suns: there is none at which the mirror can light the target; check site and days")
    half = 2 * (facets - 1)
    # Where the first suns do not yet tell all facets apart, what they tell counts: a millionth of one sun's is added.
    ridge = 1e-6 * np.diag(np.mean([np.diag(one) for one in informations], axis=0))
    total = np.zeros_like(informations[0])
    left = list(range(len(informations)))
    chosen: list[ChosenSun] = []
    while left and len(chosen) < most:
        traces = [float(np.trace(np.linalg.inv(total + informations[k] + ridge)[:half, :half])) for k in left]
        best = left.pop(int(np.argmin(traces)))
        total = total + informations[best]
        chosen.append(ChosenSun(best, total))
    return chosen
