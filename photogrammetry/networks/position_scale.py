"""Whether a network is as large as the drone's own positions say: the only length of a flight that no target gives."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import skew
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleResult

#: Two photos have a distance; a third one says whether positions and network fit.
_FEWEST = 3
#: Positions are said not to fit where chance makes so large a misfit once in a thousand flights.
_CHANCE = 1e-3
#: A scale is contradicted from so many standard deviations on: by chance in 0.3 % of the flights.
_CONTRADICTED = 3.0


@dataclass(frozen=True, slots=True)
class PositionScale:
    """Size of the flight by the drone's positions over that by the network.

    ratio, sigma_ratio: The ratio and its standard deviation, of both together; larger by the misfit where positions do
        not fit (Birge, The calculation of errors by the method of least squares, 1932).
    photos: Photos with a position.
    misfit: RMS of what a similarity leaves over what the positions' sigmas and the network let expect: 1 on average.
    fits: Whether chance makes so much.
    """

    ratio: float
    sigma_ratio: float
    photos: int
    misfit: float
    fits: bool

    @property
    def numbers(self) -> dict[str, float]:
        """What a summary says of it."""
        return {
            "positions_scale_ratio": self.ratio,
            "sigma_positions_scale_ratio": self.sigma_ratio,
            "positions_misfit_ratio": self.misfit,
        }

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What contradicts the network, or the positions themselves."""
        return (*self._misfit_doubt(), *self._scale_doubt())

    def _misfit_doubt(self) -> Iterator[Doubt]:
        if not self.fits:
            yield Doubt(
                "positions_do_not_fit",
                f"the drone's own positions are {self.misfit:.3g} times as far from the network's cameras as their "
                "sigmas let expect, whatever the scale; the scale's sigma was enlarged by as much. Was the receiver "
                "without corrections ([positions] sigma_mm), or does the log belong to another flight?",
                {"positions_misfit_ratio": self.misfit, "photos_count": self.photos},
            )

    def _scale_doubt(self) -> Iterator[Doubt]:
        if not abs(self.ratio - 1) < _CONTRADICTED * self.sigma_ratio:
            yield Doubt(
                "positions_contradict_scale",
                f"the drone's own positions of {self.photos} photos say that the flight is {self.ratio:.4f} +- "
                f"{self.sigma_ratio:.4f} times as large as by the network: lengths and coordinates of the targets, the "
                "camera's focal length, or the positions are wrong",
                {
                    "positions_scale_ratio": self.ratio,
                    "sigma_positions_scale_ratio": self.sigma_ratio,
                    "photos_count": self.photos,
                },
                Severity.SERIOUS,
            )


def scale_by_positions(
    bundle: BundleResult, photos: IntArray, enu_m: FloatArray, sigma_m: FloatArray, lever_m: FloatArray
) -> PositionScale:
    """Compare the size of a flight by positions with that by a network.

    Shapes: enu_m (n, 3), sigma_m (n, 3), lever_m (3,).
    bundle: The adjusted network.
    photos (n,): Numbers of the photos with a position, among the network's.
    lever_m: What is positioned, in the camera's frame: the antenna; zeros for the camera itself [m].
    EstimationError: Fewer than three photos.

    Notes
    -----
    The scale of a similarity, ``s = sum(d) / sum |a|^2`` with the singular values d of ``sum b a^T`` (signed, Umeyama,
    IEEE Trans. PAMI 13 (1991) 376, eq. 42), both sets about their mean. It needs no turn, which one straight pass
    leaves open.

    To first order ``ds = sum(R a . db) / sum |a|^2 - s sum(a . da) / sum |a|^2``, so that its variance follows
    from the positions' sigmas and the poses' joint covariance. Errors that all positions have in common, as that of
    the base station, do not matter; errors that drift slowly along the flight are not in the sigmas.
    """
    if len(photos) < _FEWEST:
        raise EstimationError(f"positions: {len(photos)} photos of the network have one, {_FEWEST} are needed")
    poses = [bundle.cam_from_world[int(k)] for k in photos]
    places = np.array([pose.inverse().apply(lever_m) for pose in poses])
    a, b = places - places.mean(axis=0), enu_m - enu_m.mean(axis=0)
    left, values, right = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    size = float((a**2).sum())
    ratio = float(values @ signs) / size
    turn = left @ np.diag(signs) @ right
    # What is positioned moves by -R^T ([t - l] w + dt) for the steps w, dt of x_cam = R x + t.
    steps = []
    for pose in poses:
        arm = pose.translation_m - lever_m
        steps.append(np.concatenate([-pose.rotation.T @ skew(arm), -pose.rotation.T], axis=1))
    d_steps = np.einsum("ni,nij->nj", a, np.array(steps)).ravel()
    covariance = bundle.covariance.joint((), photos)
    from_network = float(d_steps @ covariance @ d_steps) * ratio**2
    from_positions = float(((a @ turn.T) ** 2 * sigma_m**2).sum())
    left_over = b - ratio * a @ turn.T
    n, moved = len(poses), ratio * turn @ np.array(steps)
    joint = np.einsum("nij,njmk,mlk->niml", moved, covariance.reshape(n, 6, n, 6), moved, optimize=True)
    joint = joint.reshape(3 * n, 3 * n) + np.diag(sigma_m.ravel() ** 2)
    chi_square, redundancy = _beside_similarities(left_over, ratio * a @ turn.T, joint)
    misfit = float(np.sqrt(chi_square / redundancy))
    fits = chi_square < chi_square_limit(_CHANCE, redundancy)
    sigma = float(np.sqrt(from_network + from_positions)) / size
    return PositionScale(ratio, sigma if fits else sigma * misfit, len(photos), misfit, fits)


def _beside_similarities(left_over: FloatArray, places: FloatArray, covariance: FloatArray) -> tuple[float, int]:
    """Return the chi-square of what no small similarity of some places explains, and its degrees of freedom.

    left_over, places (n, 3): What is left, and the places about their mean [m].
    covariance (3 n, 3 n): Of what is left [m^2].

    What is common to the whole network, as its frame and size by the list, is no misfit.
    """
    shifts = np.tile(np.eye(3), (len(places), 1))
    turns = np.concatenate([-skew(place) for place in places])
    similarities = np.column_stack([shifts, turns, places.ravel()])
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack([left_over.ravel(), similarities]))
    rest = whitened[:, 0]
    solved, _, rank, _ = np.linalg.lstsq(whitened[:, 1:], rest, rcond=None)
    return float(((rest - whitened[:, 1:] @ solved) ** 2).sum()), rest.size - int(rank)
