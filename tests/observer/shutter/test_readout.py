"""Readout and motions of drawn networks: against one dense adjustment of everything, and against the truth."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from observer.pipeline import rolling_shutter
from observer.pipeline.rolling_shutter import Shutter, adjust_rolling, motions_of, shutter_doubts, unstated_doubt
from observer.shutter import readout
from observer.shutter.readout import Known
from photogrammetry.bundle import BundleProblem, BundleState, CameraModel, adjust
from photogrammetry.bundle.constraints import Coordinate
from photogrammetry.image_points import ImagePoints
from photogrammetry.pipeline.photos import MeasuredPhotos

CAMERA = Camera(480, 640, 1030.0, 1030.0, 239.5, 319.5)
SPEED_M_S, SIGMA_PX, SIGMA_M = 2.0, 0.03, 1e-3


class Flight:
    """A pass over targets on the rims and between them, each row taken from its own place.

    Drawn here, ray by ray, without the code under test: the row of an image point is found by bisection.
    """

    def __init__(self, seed, *, readout_s, photos=12, along_rows=True, gusts=0.0, back=False, off_path_m=0.0):
        rng = np.random.default_rng(seed)
        self.readout_s, self.rng = readout_s, rng
        across = np.repeat([-2.7, -1.2, 1.2, 2.7], 3)
        along = np.tile([-1.4, 0.0, 1.4], 4)
        self.points = np.stack([across, along, 0.15 * across**2], axis=1)
        x = np.linspace(-2.5, 2.5, photos)
        self.places = np.stack([x, 0.05 * np.sin(x), 12 - 0.1 * x], axis=1)
        self.places += off_path_m * rng.standard_normal(self.places.shape) if off_path_m else 0.0
        if back:
            self.places = np.concatenate([self.places, self.places[::-1] + [0.1, 0.4, 0.0]])
        step = np.gradient(self.places, axis=0)
        self.velocity = SPEED_M_S * step / np.linalg.norm(step, axis=1, keepdims=True)
        self.motions = readout_s * (self.velocity + gusts * SPEED_M_S * rng.standard_normal(self.velocity.shape))
        self.poses = [self._pose(place, along_rows) for place in self.places]
        self.stated = self.points + SIGMA_M * rng.standard_normal(self.points.shape)
        photo, target, pixels = [], [], []
        for k in range(len(self.poses)):
            for t, point in enumerate(self.points):
                pixel = self._taken(k, point)
                if (np.abs(pixel - [239.5, 319.5]) < [235, 315]).all():
                    photo.append(k)
                    target.append(t)
                    pixels.append(pixel)
        noise = SIGMA_PX * rng.standard_normal((len(pixels), 2))
        self.names = tuple(f"photo_{k:02d}" for k in range(len(self.poses)))
        self.table = ImagePoints(
            self.names,
            tuple(str(t) for t in range(len(self.points))),
            np.array(photo),
            np.array(target),
            np.array(pixels) + noise,
            np.tile(SIGMA_PX**2 * np.eye(2), (len(pixels), 1, 1)),
        )

    @staticmethod
    def _pose(place, along_rows):
        forward = np.array([0.1, 0.0, 0.7]) - place
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [1.0, 0.0, 0.0] if along_rows else [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        return RigidTransform(rotation, -rotation @ place)

    def _taken(self, k, point):
        def seen(row):
            after = (row - 319.5) / 640
            return CAMERA.project(self.poses[k].apply(point - after * self.motions[k]))

        low, high = -2000.0, 3000.0
        for _ in range(80):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if seen(middle)[1] > middle else (low, middle)
        return seen(0.5 * (low + high))

    @property
    def constraints(self):
        return tuple(
            Coordinate(str(t), axis, float(place[k]), SIGMA_M)
            for t, place in enumerate(self.stated)
            for k, axis in enumerate("xyz")
        )

    def network(self, measured):
        start = BundleState.from_poses([CAMERA], self.poses, self.stated)
        problem = BundleProblem(measured.points, (CameraModel("camera"),), constraints=self.constraints)
        bundle = adjust(problem, start)
        assert bundle.converged
        return SimpleNamespace(solved=SimpleNamespace(bundle=bundle))

    def measured(self):
        none = np.full((self.table.n, 2, 2), np.nan)
        return MeasuredPhotos(self.table, none, None, (), (), sigma_assumed=False)

    def rolled(self, shutter=None):
        return adjust_rolling(self.network, self.measured(), shutter or Shutter(speed_m_s=SPEED_M_S))

    def eyes_over_sigma(self, found):
        """Errors of all camera places together, whitened by the covariance of the poses."""
        bundle = found.network.solved.bundle
        covariance = bundle.covariance.joint((), np.arange(len(self.poses)))
        steps = found.motions.moved_poses
        covariance = covariance + steps @ found.motions.covariance_m2 @ steps.T
        error = []
        for pose, true in zip(bundle.cam_from_world, self.poses, strict=True):
            # The step (w, d) that takes the pose to the truth: exp(w) R and t + d are the true ones.
            turn = true.rotation @ pose.rotation.T
            w = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            error += [w, true.translation_m - pose.translation_m]
        return np.linalg.solve(np.linalg.cholesky(covariance), np.concatenate(error))


def test_readout_and_poses_are_those_of_one_dense_adjustment(monkeypatch):
    spread = 2e-3
    monkeypatch.setattr(readout, "_SPREADS_M", np.array([spread]))
    flight = Flight(4, readout_s=0.02, photos=6)
    found = flight.rolled()
    bundle, n, count = found.network.solved.bundle, 6, len(flight.points)
    shutter = Shutter(speed_m_s=SPEED_M_S)
    path = shutter.flight(flight.names, bundle.state.centers_m)
    relative = path.doubt / np.median(path.doubt)
    table = flight.table

    def residuals(unknowns):
        poses = [
            pose.moved(step) for pose, step in zip(bundle.cam_from_world, unknowns[: 6 * n].reshape(n, 6), strict=True)
        ]
        places = bundle.points_m + unknowns[6 * n : 6 * n + 3 * count].reshape(count, 3)
        motions, time = unknowns[-3 * n - 1 : -1].reshape(n, 3), unknowns[-1]
        rows = []
        for k, t, pixel in zip(table.photo_index, table.target_index, table.pixels_px, strict=True):
            seen = CAMERA.project(poses[k].apply(places[t]))
            for _ in range(8):
                seen = CAMERA.project(poses[k].apply(places[t] - (seen[1] - 319.5) / 640 * motions[k]))
            rows.append((seen - pixel) / SIGMA_PX)
        known = (places - flight.stated) / SIGMA_M
        gusts = (motions - time * path.velocity) / (spread * relative[:, None])
        return np.concatenate([np.ravel(rows), known.ravel(), gusts.ravel()])

    start = np.concatenate([np.zeros(6 * n + 3 * count), found.motions.motions_m.ravel(), [found.motions.readout]])
    scale = np.concatenate([np.full(6 * n + 3 * count, 1e-4), np.full(3 * n, 1e-3), [1e-4]])
    whole = least_squares(residuals, start, x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-12)
    covariance = np.linalg.inv(whole.jac.T @ whole.jac)
    sigma = np.sqrt(np.diag(covariance))
    # Image points are moved by a projection, whose derivative is that of the middle row: 0.5 % of what is left.
    assert np.abs((whole.x - start) / sigma).max() < 0.15
    assert found.motions.sigma_readout == pytest.approx(sigma[-1], rel=0.03)
    steps = found.motions.moved_poses
    poses = bundle.covariance.joint((), np.arange(n)) + steps @ found.motions.covariance_m2 @ steps.T
    np.testing.assert_allclose(np.sqrt(np.diag(poses)), sigma[: 6 * n], rtol=0.03)


@pytest.mark.parametrize("readout_s", [0.02, -0.03])
def test_readout_is_found_within_its_sigma_over_many_flights(readout_s):
    errors, places = [], []
    for seed in range(10):
        flight = Flight(100 + seed, readout_s=readout_s, along_rows=seed % 2 == 0, gusts=0.05)
        found = flight.rolled()
        errors.append((found.motions.readout - readout_s) / found.motions.sigma_readout)
        places.append(flight.eyes_over_sigma(found))
    low, high = chi2.ppf([0.005, 0.995], len(errors))
    assert low < np.square(errors).sum() < high
    # Poses of a flight share the errors of the list: all flights together.
    total = np.square(np.concatenate(places))
    low, high = chi2.ppf([0.001, 0.999], total.size) / total.size
    assert low < total.mean() < high


class LosingFlight(Flight):
    """A network that has some photos only where their image points fit the pose of a camera at rest to some pixels.

    at_first: Whether it has all of them the first time.
    """

    losing, fits_px, at_first = (0, 5), 1.0, False

    def network(self, measured):
        if self.at_first:
            self.at_first = False
            return super().network(measured)
        table = measured.points
        rest = np.array(
            [
                CAMERA.project(self.poses[k].apply(self.points[t]))
                for k, t in zip(table.photo_index, table.target_index, strict=True)
            ]
        )
        off = np.linalg.norm(table.pixels_px - rest, axis=1).max
        lost = [k for k in self.losing if off(where=table.photo_index == k, initial=0.0) > self.fits_px]
        kept = [k for k in range(len(self.poses)) if k not in lost]
        rows = np.isin(table.photo_index, kept)
        number = np.searchsorted(kept, table.photo_index[rows])
        some = ImagePoints(
            tuple(table.photos[k] for k in kept),
            table.targets,
            number,
            table.target_index[rows],
            table.pixels_px[rows],
            table.covariance_px2[rows],
        )
        start = BundleState.from_poses([CAMERA], [self.poses[k] for k in kept], self.stated)
        problem = BundleProblem(some, (CameraModel("camera"),), constraints=self.constraints)
        return SimpleNamespace(solved=SimpleNamespace(bundle=adjust(problem, start)))


def test_photos_that_fit_no_pose_before_the_readout_is_known_come_back():
    flight = LosingFlight(11, readout_s=0.03)
    assert len(flight.network(flight.measured()).solved.bundle.cam_from_world) == 10
    found, whole = flight.rolled(), Flight(11, readout_s=0.03).rolled()
    assert found.motions.photos == flight.names
    np.testing.assert_allclose(found.motions.motions_m, whole.motions.motions_m, atol=1e-4)
    assert found.motions.readout == pytest.approx(whole.motions.readout, abs=0.1 * whole.motions.sigma_readout)


def test_a_photo_lost_on_the_way_is_moved_as_its_own_part_of_the_path_says():
    # Ways past neighbours differ by up to 40 mm of 60, which moves points by up to 1.7 px; 0.25 px are forgiven.
    flight, whole = (kind(14, readout_s=0.03, off_path_m=0.2) for kind in (LosingFlight, Flight))
    flight.losing, flight.at_first, flight.fits_px = (3, 6), True, 0.25
    found, alike = flight.rolled(), whole.rolled()
    assert found.motions.photos == flight.names
    assert found.motions.readout == pytest.approx(alike.motions.readout, abs=0.1 * alike.motions.sigma_readout)
    np.testing.assert_allclose(found.motions.motions_m, alike.motions.motions_m, atol=1e-4)


def test_the_next_part_of_the_way_is_found_from_the_part_that_was_really_gone(monkeypatch):
    flight, calls, gone = Flight(11, readout_s=0.03), [], []
    part_of_the_way = rolling_shutter._part_of_the_way

    def refused_at_first(measured):
        calls.append(measured)
        if len(calls) in (2, 3):
            raise EstimationError("these image points fit no poses")
        return flight.network(measured)

    def noted(last, was_left_m, left_m):
        gone.append((last, was_left_m - left_m, was_left_m))
        return part_of_the_way(last, was_left_m, left_m)

    monkeypatch.setattr(rolling_shutter, "_part_of_the_way", noted)
    found = adjust_rolling(refused_at_first, flight.measured(), Shutter(speed_m_s=SPEED_M_S))
    # All of the way and half of it were refused, a quarter was not.
    last, changed_m, was_left_m = gone[0]
    assert last == 0.25
    assert np.linalg.norm(changed_m) == pytest.approx(0.25 * np.linalg.norm(was_left_m), rel=0.35)
    alike = flight.rolled().motions
    assert found.motions.readout == pytest.approx(alike.readout, abs=0.1 * alike.sigma_readout)


def test_a_stated_readout_is_used_with_its_sigma():
    flight = Flight(7, readout_s=0.02)
    alone = flight.rolled().motions
    stated = flight.rolled(Shutter(Known(0.02, 1e-5), SPEED_M_S))
    assert stated.motions.sigma_readout < 0.2 * alone.sigma_readout
    assert abs(stated.motions.readout - 0.02) < 4e-5
    assert not shutter_doubts(stated, Shutter(Known(0.02, 1e-5), SPEED_M_S))


def test_twice_the_time_is_contradicted_and_not_used():
    flight, wrong = Flight(8, readout_s=0.02), Shutter(Known(0.04, 0.001), SPEED_M_S)
    found = flight.rolled(wrong)
    (doubt,) = shutter_doubts(found, wrong)
    assert doubt.code == "rolling_shutter_contradicted"
    assert abs(found.motions.readout - 0.02) < 4 * found.motions.sigma_readout


@pytest.mark.parametrize("along_rows", [True, False])
def test_a_shutter_that_nobody_stated_is_named(along_rows):
    rolling = Flight(9, readout_s=0.02, along_rows=along_rows)
    doubt = unstated_doubt(rolling.network(rolling.measured()))
    assert doubt is not None
    assert doubt.code == "rolling_shutter_not_stated"
    assert doubt.numbers["motion_m"] == pytest.approx(0.04, abs=0.01)
    assert "[rolling_shutter]" in doubt.text
    # The table is refused with targets without codes.
    without_codes = unstated_doubt(rolling.network(rolling.measured()), can_be_stated=False)
    assert without_codes is not None
    assert "[rolling_shutter]" not in without_codes.text


def test_a_steady_readout_is_that_of_motions_which_the_path_leaves_no_room(monkeypatch):
    monkeypatch.setattr(readout, "_SPREADS_M", np.array([1e-7]))
    flight = Flight(5, readout_s=0.02, photos=6)
    network = flight.network(flight.measured())
    bundle = network.solved.bundle
    path = Shutter().flight(flight.names, bundle.state.centers_m)
    found, _ = motions_of(network, Shutter(), path, {})
    value, sigma = readout.steady_readout(bundle, path)
    assert value == pytest.approx(found.readout, rel=1e-4)
    assert sigma == pytest.approx(found.sigma_readout, rel=1e-4)


def test_photos_taken_at_once_raise_no_doubt():
    for seed in range(6):
        still = Flight(200 + seed, readout_s=0.0, along_rows=seed % 2 == 0, back=seed % 3 == 0)
        assert unstated_doubt(still.network(still.measured())) is None
