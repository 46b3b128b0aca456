"""The least errors that any evaluation of a laser scan of a trough can have: Cramer and Rao's bound."""

import numpy as np
from scipy.interpolate import BSpline

from data_synth.lasers import LaserScene

#: Numbers of the instrument: offset x, y, distance, place of the laser x, y, scales of target and of angles, roll.
_SIGMAS = (
    "sigma_offset_m",
    "sigma_offset_m",
    "sigma_distance_m",
    "sigma_laser_place_m",
    "sigma_laser_place_m",
    "sigma_target_scale",
    "sigma_target_scale",
    "sigma_angle_scale",
    "sigma_angle_scale",
    "sigma_roll_rad",
)
#: What is moved for derivatives, and its step: the instrument [sigma], height and slopes of the surface, directions.
_INSTRUMENT, _SURFACE, _BEAMS = (0, 10, 0.1), (1, 3, 1e-5), (2, 2, 1e-6)


def least_sigmas(scene: LaserScene) -> np.ndarray:
    """Return the least standard deviations of the slopes where beams meet the panel, without their mean (2, n) [rad].

    The stated sigmas are priors (van Trees' form of the bound). No shape is assumed: heights of a tensor spline, as
    many as beams on the panel, and the ten numbers of the instrument are sought together from all spots; that slopes
    are those of one surface is used. The height of the origin is zero: it is the distance.
    """
    scan = _Scan(scene)
    bent = scan.heights((0, 0)), scan.heights((1, 0)), scan.heights((0, 1))
    by_height = sum(scan.moved(_SURFACE, k)[..., None] * bent[k][:, None] for k in range(3))
    by_instrument = np.stack([scan.moved(_INSTRUMENT, k) for k in range(10)], axis=-1)
    by_beam = np.stack([scan.moved(_BEAMS, k) for k in range(2)], axis=-1)
    noise = scene.sigma_spot_m**2 * np.eye(2) + scene.sigma_direction_rad**2 * by_beam @ np.swapaxes(by_beam, 1, 2)
    root, count = np.linalg.inv(np.linalg.cholesky(noise)), by_height.shape[-1]
    design = (root @ np.concatenate([by_height, by_instrument], axis=-1)).reshape(-1, count + 10)
    prior = np.zeros((11, count + 10))
    prior[:10, count:] = np.eye(10)
    prior[10, :count] = scan.heights((0, 0), np.zeros((2, 1)))[0] / 1e-6
    rows = np.concatenate([design, prior])
    covariance = np.linalg.pinv(rows.T @ rows, rcond=1e-14, hermitian=True)[:count, :count]
    centred = (one - one.mean(axis=0) for one in bent[1:])
    return np.sqrt([np.einsum("nk,kl,nl->n", one, covariance, one) for one in centred])


class _Scan:
    """Beams over a trough in place, and what its spots do when something moves."""

    def __init__(self, scene: LaserScene) -> None:
        self.focal, self.distance = scene.focal_length_m, 2 * scene.focal_length_m
        self.sigma = np.array([getattr(scene, name) for name in _SIGMAS])
        self.half = 0.5 * np.array([scene.width_m, scene.length_m])
        self.counts = [int(one / 1.1) for one in (scene.columns, scene.rows)]
        ends = 1.1 * self.half / self.distance
        steps = (np.linspace(-end, end, count) for end, count in zip(ends, (scene.columns, scene.rows), strict=True))
        self.angles = np.arctan(np.stack(np.meshgrid(*steps))).reshape(2, -1)
        self.places = self._spots(*self._at_rest())[1]
        self.on = (np.abs(self.places) <= self.half[:, None]).all(axis=0)

    def _at_rest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = self.angles.shape[1]
        return np.zeros(10), np.zeros((3, count)), np.zeros((2, count))

    def heights(self, order: tuple[int, int], places: np.ndarray | None = None) -> np.ndarray:
        """Return derivatives of the spline's terms at places (2, n), by default where beams meet the panel."""
        parts = []
        for half, count, by, at in zip(
            self.half, self.counts, order, self.places[:, self.on] if places is None else places, strict=True
        ):
            knots = np.concatenate([[-half] * 3, np.linspace(-half, half, count - 2), [half] * 3])
            spline = BSpline(knots, np.eye(count), 3)
            parts.append((spline.derivative(by) if by else spline)(at))
        return (parts[0][:, :, None] * parts[1][:, None]).reshape(parts[0].shape[0], -1)

    def moved(self, what: tuple[int, int, float], number: int) -> np.ndarray:
        """Return the derivatives of the spots by one of the inputs, shape (n, 2)."""
        ends = []
        for sign in (1, -1):
            inputs = self._at_rest()
            inputs[what[0]][number] = sign * what[2]
            ends.append(self._spots(*inputs)[0])
        return ((ends[0] - ends[1]) / (2 * what[2]))[:, self.on].T

    def _spots(self, amounts: np.ndarray, bent: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return spots and where beams meet the mirror, both (2, n); bent (3, n): height and slopes added there."""
        off = self.sigma * amounts
        tangents = np.tan((1 + off[7:9, None]) * self.angles + noise)
        beam = np.vstack([tangents, -np.ones(tangents.shape[1])])
        start = np.array([-off[0], -off[1], self.distance - off[2]])[:, None]
        # Where start + t beam has the height x^2 / 4 f + h.
        a, b = beam[0] ** 2 / (4 * self.focal), start[0] * beam[0] / (2 * self.focal) - beam[2]
        c = start[0] ** 2 / (4 * self.focal) + bent[0] - start[2]
        at = start - 2 * c / (b + np.sqrt(b * b - 4 * a * c)) * beam
        normal = np.stack([-at[0] / (2 * self.focal) - bent[1], -bent[2], np.ones_like(at[0])])
        back = beam - 2 * (beam * normal).sum(axis=0) / (normal**2).sum(axis=0) * normal
        there = at + (start[2] - at[2]) / back[2] * back - start
        turned = np.stack([there[0] - off[9] * there[1], there[1] + off[9] * there[0]])
        return (turned + off[3:5, None]) * (1 + off[5:7, None]), at[:2]
