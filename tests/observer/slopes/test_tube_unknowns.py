"""What touching lines have in common: derivatives, the glass against traced rays, what the reflection's width tells."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.geometry.rigid import looking_at
from observer.photo_edges.outward_edges import moved_outward
from observer.photo_edges.reflection_edges import ReflectionEdges, design_misfit
from observer.photo_edges.views import View
from observer.planning.photo_network import Believed
from observer.planning.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.planning.simulated_flight import Evaluation, simulate
from observer.product.slope_map import angle_maps
from observer.selection.solve_and_refuse import Reflector, _Nominal, solve_reflector
from observer.slopes.common_unknowns import CommonUnknowns, beside_poses, common_unknowns, glass_widening_rad
from observer.slopes.pose_modes import CameraModes, Photos
from observer.slopes.row_spline import Roughness
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2
from observer.trough.expectation import Expectation
from observer.trough.glass import glass_beside_tube, turned_rad
from observer.trough.observation_equation import Misfit, Sights, misfit
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.absorber.test_absorber_glass import distance_within
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

LS2 = ls2()
STATIONS_M = np.linspace(-4.0, 4.0, 17)
PRIOR_M = 5e-4


def expected(covariance: np.ndarray) -> Expectation:
    path = AbsorberPath(STATIONS_M, np.full(17, 1e-3), np.full(17, 1.488), covariance)
    return Expectation(LS2, path, np.array([0.0]))


def some_edges(rng: np.random.Generator) -> tuple[ReflectionEdges, Sights]:
    """Return edges of three photos anywhere on the mirror, near enough to where they can be."""
    m = 60
    x, y = rng.uniform(-2.4, 2.4, m), rng.uniform(-3.0, 3.0, m)
    points = np.stack([x, y, x**2 / (4 * 1.49)], axis=1)
    side = np.where(rng.uniform(size=m) < 0.5, 1.0, -1.0)
    eyes = np.stack([x + rng.normal(0, 0.1, m), rng.uniform(-0.5, 0.5, m), np.full(m, 15.0)], axis=1)
    photo = np.arange(m) % 3
    edges = ReflectionEdges(
        photo, np.zeros(m, dtype=np.intp), side, points, np.full(m, 2e-4), -0.5 * side, 0 * side, side == 0
    )
    return edges, Sights(points, eyes, side)


def unknowns_of(edges: ReflectionEdges, sights: Sights, where: Expectation) -> tuple[CommonUnknowns, Misfit]:
    modes = CameraModes(
        2 * edges.photo[:, None] + np.arange(2),
        np.zeros((edges.photo.size, 2)),
        np.eye(6),
        np.zeros((3, 6, 2)),
        np.zeros((3, 2, 6)),
    )
    found = design_misfit(sights.points_m, sights.eyes_m, sights.side, where.collector, where.absorber)
    return common_unknowns(beside_poses(edges, sights, found, where), edges.photo, modes), found


def effect(unknowns: CommonUnknowns, common: np.ndarray) -> np.ndarray:
    return np.asarray((unknowns.derivative * common[unknowns.index]).sum(axis=1))


def test_derivatives_with_respect_to_place_and_radius() -> None:
    rng = np.random.default_rng(0)
    edges, sights = some_edges(rng)
    where = expected(PRIOR_M**2 * np.eye(34))
    unknowns, before = unknowns_of(edges, sights, where)
    common = np.zeros(len(unknowns.covariance))
    # Along the trough the tube is moved slowly: by how much it leans is held in the derivatives.
    common[unknowns.place] = 1e-5 * np.sin(2 * np.pi / 8.0 * np.tile(STATIONS_M, 2) + np.repeat([0.3, 1.7], 17))
    path = unknowns.moved(where.absorber, common, unknowns.covariance)
    moved = design_misfit(sights.points_m, sights.eyes_m, sights.side, LS2, path)
    changed = moved.angle_rad - before.angle_rad
    np.testing.assert_allclose(changed, effect(unknowns, common), atol=0.01 * np.abs(changed).max())
    common[:] = 0.0
    common[unknowns.radius] = 1e-5 / unknowns.units[0]
    wider = replace(LS2, absorber_diameter_m=LS2.absorber_diameter_m + 2e-5)
    moved = design_misfit(sights.points_m, sights.eyes_m, sights.side, wider, where.absorber)
    np.testing.assert_allclose(moved.angle_rad - before.angle_rad, effect(unknowns, common), atol=2e-9)


def test_edges_that_all_lie_outward_look_like_a_wider_tube() -> None:
    edges, sights = some_edges(np.random.default_rng(1))
    unknowns, found = unknowns_of(edges, sights, expected(PRIOR_M**2 * np.eye(34)))
    outward = unknowns.derivative[:, -3]
    # 0.1 mrad at the camera is 1.4 mm on the mirror; the band is 0.6 m wide for a tube of 70 mm.
    shift = effect(unknowns, np.where(np.arange(len(unknowns.covariance)) == unknowns.radius + 1, 1.0, 0.0))
    np.testing.assert_allclose(shift, outward)
    assert np.all(np.sign(outward) == -np.sign(found.d_angle_d_radius))


def test_an_edge_that_lies_outward_stands_where_a_bent_mirror_has_another_slope() -> None:
    """0.02 / m beside the design change by half what a displacement does."""
    edges, _ = some_edges(np.random.default_rng(2))
    where, bend, by_rad, focal = expected(np.zeros((34, 34))), 0.02, 1e-6, LS2.focal_length_m
    poses = [looking_at(np.array([x, 0.3, 15.0]), np.zeros(3), np.array([0.0, 1.0, 0.0])) for x in (-0.8, 0.0, 0.9)]
    photos = Photos(tuple(poses), 1e-8 * np.eye(18))

    def missed_by(displacement_rad: float) -> np.ndarray:
        points = moved_outward(edges, np.full(3, displacement_rad), photos.eyes_m, focal).points_m
        slopes = points[:, 0] / (2 * focal) + bend * (points[:, 0] - edges.points_m[:, 0]), np.zeros(edges.row.size)
        sights = Sights(points, photos.eyes_m[edges.photo], edges.side)
        return misfit(sights, slopes, where.absorber, LS2.absorber_diameter_m / 2).angle_rad

    change = (missed_by(by_rad) - missed_by(-by_rad)) / (2 * by_rad)
    design = _Nominal(edges, photos, where, 0.0)
    bent = design.bent(np.full(edges.row.size, bend))
    found, plain = (
        np.where(one.index == one.radius + 1, one.derivative, 0.0).sum(axis=1) / one.units[1]
        for one in (bent.unknowns, design.unknowns)
    )
    np.testing.assert_allclose(found, change, rtol=1e-4)
    assert np.median(np.abs(plain / change - 1)) > 0.3


def half_width_m(axis: np.ndarray, direction: float) -> float:
    """Return half the width of the metal, traced through glass around the origin, seen from far away."""
    eye = 400.0 * np.array([-np.sin(direction), np.cos(direction)])
    towards = np.arctan2(axis[0] - eye[0], eye[1] - axis[1])
    edges = []
    for side in (1.0, -1.0):
        low, high = towards, towards + side * 1.25 * 0.035 / 400
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if abs(distance_within(eye, middle, axis)) < 0.035 else (low, middle)
        edges.append(low)
    return 0.5 * 400.0 * (edges[0] - edges[1])


@pytest.mark.parametrize("direction", [-0.9, 0.0, 0.6])
def test_glass_beside_the_tube_widens_it_as_traced_rays_say(direction: float) -> None:
    beside = np.array([2e-3, -3e-3])
    # Rays come from above along (sin, -cos); the unknown is the glass's place from the tube, the reverse of `beside`.
    ray = np.array([np.sin(direction), -np.cos(direction)])
    wider = half_width_m(beside, direction) - half_width_m(np.zeros(2), direction)
    assert wider == pytest.approx(-turned_rad(LS2, 1.0) * float(beside @ ray), abs=6e-6)


def sagging(collector: Collector) -> tuple[Expectation, AbsorberPath]:
    """Return a tube that sags by 8 mm in its first receiver and is bent by 3 mm across in its second."""
    y = np.linspace(-4.0, 4.0, 401)
    arch = np.sin(np.pi * np.clip(np.abs(y) - 0.15, 0, 3.6) / 3.6)
    path = AbsorberPath(y, 3e-3 * arch * (y > 0), 1.49 - 8e-3 * arch * (y < 0), np.zeros((802, 802)))
    return Expectation(collector, path, np.array([0.0])), path


HELD = replace(LS2, support_y_m=np.array([-3.9, 0.0, 3.9]))


def test_straight_glass_is_beside_a_tube_that_sags_within_it() -> None:
    _, path = sagging(HELD)
    # The path is straight between stations 20 mm apart.
    beside = glass_beside_tube(HELD, path, np.array([-3.75, -1.95, -0.15, 0.15, 1.95, 3.75]))
    assert beside.receiver.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(beside.x_m, [0, 0, 0, 0, -3e-3, 0], atol=2e-5)
    np.testing.assert_allclose(beside.z_m, [0, 8e-3, 0, 0, 0, 0], atol=4e-5)
    # Without supports nothing says where a piece of glass begins.
    assert not glass_beside_tube(LS2, path, np.array([-1.95, 1.95])).z_m.any()


def test_a_tube_that_sags_in_straight_glass_looks_as_traced_rays_say() -> None:
    where, path = sagging(HELD)
    edges, sights = some_edges(np.random.default_rng(8))
    _, found = unknowns_of(edges, sights, where)
    moved = glass_widening_rad(found, sights, where) / found.d_angle_d_radius
    glass = glass_beside_tube(HELD, path, found.passing_y_m)
    tube = -np.stack([glass.x_m, glass.z_m], axis=1)
    axis = np.stack(path.at(found.passing_y_m), axis=1)
    for k in range(0, 60, 6):
        # What is traced looks downwards; the reflection looks up, which is the same seen upside down.
        way = axis[k] - sights.points_m[k, [0, 2]]
        upside = tube[k] * [1.0, -1.0]
        direction = float(np.arctan2(way[0], way[1]))
        traced = half_width_m(upside, direction) - half_width_m(np.zeros(2), direction)
        # What is left is of higher order in the distance: 6 um of 120 um at 8 mm.
        assert moved[k] == pytest.approx(traced, abs=12e-6)
    assert np.abs(moved).max() > 1e-4


def test_where_the_tube_moves_within_straight_glass_its_width_follows() -> None:
    edges, sights = some_edges(np.random.default_rng(10))
    where = expected(PRIOR_M**2 * np.eye(34))
    held = replace(where, collector=HELD)
    (unknowns, before), (plain, _) = (unknowns_of(edges, sights, one) for one in (held, where))
    step = 1e-5 * np.sin(2 * np.pi / 8.0 * np.tile(STATIONS_M, 2) + np.repeat([0.3, 1.7], 17))
    common, without = np.zeros(len(unknowns.covariance)), np.zeros(len(plain.covariance))
    common[unknowns.place] = without[plain.place] = step
    later = replace(held, absorber=unknowns.moved(held.absorber, common, unknowns.covariance))
    moved = design_misfit(sights.points_m, sights.eyes_m, sights.side, HELD, later.absorber)
    glass = glass_widening_rad(moved, sights, later) - glass_widening_rad(before, sights, held)
    by_glass = effect(unknowns, common) - effect(plain, without)
    np.testing.assert_allclose(by_glass, glass, atol=0.02 * np.abs(glass).max())
    assert np.abs(glass).max() > 1e-8


def test_each_glass_has_a_place_of_its_own() -> None:
    where, _ = sagging(HELD)
    edges, sights = some_edges(np.random.default_rng(9))
    unknowns, found = unknowns_of(edges, sights, where)
    assert unknowns.units.size == 2 + 2 * 2
    second = np.zeros(len(unknowns.covariance))
    second[unknowns.radius + 4] = 1.0
    moves = effect(unknowns, second) != 0
    assert (moves == (found.passing_y_m > 0)).all()


def test_no_glass_turns_nothing() -> None:
    assert turned_rad(Collector(5.0, 7.89, 1.49, 0.070), 1.2) == 0.0
    assert turned_rad(LS2, 1.0) == pytest.approx(0.01776, abs=1e-5)


def test_a_tube_whose_place_is_given_is_held() -> None:
    edges, sights = some_edges(np.random.default_rng(2))
    where = expected(np.zeros((34, 34)))
    unknowns, _ = unknowns_of(edges, sights, where)
    assert not unknowns.is_place.any()
    assert len(unknowns.covariance) == 6 + 3 + 4
    assert unknowns.moved(where.absorber, np.zeros(13), np.eye(13)) is where.absorber


def solved(rng: np.random.Generator, radius_m: float = 0.035) -> tuple[Reflector, AbsorberPath, AbsorberPath]:
    """Simulate a pass over a smooth mirror, with a tube that is believed where its prior draws it."""
    scene = short_scene(TypicalMirror.drawn(short_trough(), rng, 0.2e-3, 0.0), photos=40, rows=10)
    truth = scene.truth
    wide = replace(truth, collector=replace(truth.collector, absorber_diameter_m=2 * radius_m))
    believed = believed_with_errors(scene, rng, position_m=1e-3)
    edges = measured_edges(scene, true_edges(replace(scene, truth=wide), EdgeNoise(0.05, 0.1)), believed.views, rng)
    y = np.array([-1.58, 1.58])
    x, z = truth.absorber.at(y)
    # Offsets and tilts, as the targets leave them open.
    covariance = PRIOR_M**2 * (np.kron(np.eye(2), np.ones((2, 2))) + np.kron(np.eye(2), [[1.0, -1.0], [-1.0, 1.0]]))
    covariance += 1e-12 * np.eye(4)
    wrong = rng.multivariate_normal(np.zeros(4), covariance)
    start = AbsorberPath(y, x + wrong[:2], z + wrong[2:], covariance)
    photos: Photos = believed.photos
    reflector = solve_reflector(edges, photos, replace(truth, absorber=start), 0.1, Roughness(1e-4, 1e-4))
    return reflector, start, AbsorberPath(y, x, z, covariance)


@pytest.mark.slow
def test_the_width_of_the_reflection_adds_to_where_the_tube_is_and_the_sigma_is_the_scatter() -> None:
    rng = np.random.default_rng(3)
    gains, normalised = [], []
    for _ in range(8):
        reflector, start, true = solved(rng)
        path = reflector.absorber
        error = np.concatenate([path.x_m - true.x_m, path.z_m - true.z_m])
        normalised.append(error @ np.linalg.solve(path.covariance_m2, error))
        gains.append(np.diagonal(path.covariance_m2) / np.diagonal(start.covariance_m2))
    # 32 squares of unit variance: 99 % lie between 0.47 and 1.7 times 4.
    assert 0.47 * 4 < np.mean(normalised) < 1.7 * 4
    assert np.mean(gains) < 0.9


@pytest.mark.parametrize("is_coupled", [True, False])
def test_a_frame_that_leans_turns_all_slopes_by_as_much(is_coupled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses and tube err together where the targets lean; as independent errors they would add up to 0.7 of it."""
    rng = np.random.default_rng(6)
    scene = short_scene(TypicalMirror.drawn(short_trough(), rng, 0.2e-3, 0.0), photos=40, rows=10)
    leaning = 1e-4
    # p' = R (P + a x P) + t: the step of each pose is a turn by R a.
    steps = np.array([[*pose.rotation[:, 1], 0.0, 0.0, 0.0] for _, pose in scene.views]).reshape(-1)
    covariance = leaning**2 * np.outer(steps, steps) + np.diag(np.tile([1e-7, 1e-7, 1e-7, 1e-6, 1e-6, 1e-6], 40) ** 2)
    if not is_coupled:
        monkeypatch.setattr(
            CameraModes, "read", lambda self, with_steps: np.zeros((len(with_steps), len(self.covariance)))
        )
    evaluation = Evaluation(column_step_m=0.1, station_step_m=0.5, along_rad=1e-4)
    means = []
    for share in (0.0, 1.0):
        views = [
            View(camera, pose.moved(share * leaning * step))
            for (camera, pose), step in zip(scene.views, steps.reshape(-1, 6), strict=True)
        ]
        one = simulate(
            scene, Believed(tuple(views), covariance), EdgeNoise(0.05, 0.1), evaluation, np.random.default_rng(7)
        )
        means.append(float(np.nanmean(one.slope_map.slope_error_x)))
    slopes = one.slope_map
    modes = slopes.common.evaluate(*np.meshgrid(slopes.x_m, slopes.y_m))[:, 0]
    sigma = float(np.sqrt((modes[:, slopes.valid].mean(axis=1) ** 2).sum()))
    assert (sigma == pytest.approx(abs(means[1] - means[0]), rel=0.15)) is is_coupled


def test_a_tube_that_is_thicker_than_stated_is_found_so() -> None:
    found = []
    for radius in (0.035, 0.0352):
        reflector, _, _ = solved(np.random.default_rng(4), radius)
        found.append(float(reflector.errors.common[reflector.unknowns.radius] * reflector.unknowns.units[0]))
    # A share of it goes to the displacement of all edges, which is as uncertain.
    assert 0.05e-3 < found[1] - found[0] < 0.25e-3


def test_place_looks_like_the_slope_that_theta_a_is() -> None:
    rng = np.random.default_rng(3)
    where = expected(PRIOR_M**2 * np.eye(34))
    unknowns, _ = unknowns_of(*some_edges(rng), where)
    scene = short_scene(TypicalMirror.drawn(short_trough(), rng, 2e-3, 0.0), rows=4)
    believed = believed_with_errors(scene, rng)
    mirror = simulate(scene, believed, EdgeNoise(), Evaluation(measures_absorber=False), rng).slope_map
    move = 1e-5 * rng.standard_normal((2, 17))
    path = where.absorber
    moved = replace(path, x_m=path.x_m + move[0], z_m=path.z_m + move[1])
    before, after = (angle_maps(mirror, one, LS2).theta_a_rad for one in (path, moved))
    looks = unknowns.place_as_slope(where, mirror.y_m, mirror.x_m) @ move.reshape(-1)
    turned = looks / (1 + (mirror.x_m / (2 * LS2.focal_length_m)) ** 2)
    np.testing.assert_allclose(turned, after - before, atol=1e-4 * np.abs(turned).max())
