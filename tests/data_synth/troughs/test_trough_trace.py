"""Rays at a trough: edges of the absorber's reflection against closed forms, glass against Snell's law in space."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.optics.surface_errors import Polynomial, Ripple, SurfaceErrors
from data_synth.troughs.mirror import Rays, TroughMirror
from data_synth.troughs.receiver import Receiver, ReceiverTable, TubeAxis
from data_synth.troughs.scene import world_of
from data_synth.troughs.surroundings import Sky, Surroundings
from data_synth.troughs.trace import Finish, Tracer
from heliogauge.geometry.rays import reflect
from heliogauge.validate import FloatArray
from observer.trough import Collector, ls2

BARE = replace(ls2(), glass=None)
FOCAL = 1.49
#: Far below everything else in these scenes.
BLACK = Finish(absorber=0.0)


def refract(ray: FloatArray, normal: FloatArray, before: float, behind: float) -> FloatArray:
    """Refract a unit direction at an interface by Snell's law in vector form."""
    across = ray @ normal
    along = before / behind * (ray - across * normal)
    return along + np.copysign(np.sqrt(1 - along @ along), across) * normal


def rays_between(cameras: FloatArray, points: FloatArray) -> Rays:
    step = points - cameras
    return Rays(*np.ascontiguousarray(cameras.T), *np.ascontiguousarray(step.T))


def sees_absorber(tracer: Tracer, x: FloatArray, y: FloatArray, phi: FloatArray, along: float) -> np.ndarray:
    """Look at mirror points from 14 m under the transverse angle phi and a slope along the trough."""
    points = np.stack([x, y, x * x / (4 * FOCAL)], axis=1)
    cameras = points + 14 * np.stack([np.sin(phi), np.full_like(phi, along), np.cos(phi)], axis=1)
    return np.asarray(tracer.look(rays_between(cameras, points)).light < 0.03)


@pytest.fixture(scope="module")
def places() -> tuple[FloatArray, FloatArray]:
    # Off the receiver's own shade: the direct view of the tube is at x near 0 for phi near 0.
    x = np.concatenate([np.linspace(-2.45, -0.2, 60), np.linspace(0.2, 2.45, 60)])
    return x, np.linspace(-2.5, 2.5, x.size)


@pytest.mark.parametrize("along", [0.0, -0.12, 0.2])
def test_a_perfect_trough_shows_the_tube_within_its_half_width(
    places: tuple[FloatArray, FloatArray], along: float
) -> None:
    x, y = places
    tracer = Tracer(world_of(TroughMirror(BARE), finish=BLACK), np.float64)
    half = np.arcsin(0.035 / np.hypot(x, FOCAL - x * x / (4 * FOCAL)))
    for side in (-1, 1):
        assert sees_absorber(tracer, x, y, side * half * (1 - 1e-6), along).all()
        assert not sees_absorber(tracer, x, y, side * half * (1 + 1e-6), along).any()


@pytest.mark.parametrize("along", [0.0, 0.2])
def test_slope_errors_and_displaced_absorber_move_the_edges_as_derived(
    places: tuple[FloatArray, FloatArray], along: float
) -> None:
    # Phi = 2 theta_r + (beta_0 - beta) -/+ w, with the repaired sign of theta_a.
    x, y = places
    errors = SurfaceErrors((Polynomial([(1, 0, 2e-3), (2, 0, -5e-4), (1, 1, 4e-4)]),))
    mirror = TroughMirror(BARE, transverse=errors)
    offset_x, offset_z = 3e-3, -5e-3
    receiver = Receiver(BARE, TubeAxis.straight(offset_x, offset_z))
    tracer = Tracer(world_of(mirror, receiver, finish=BLACK), np.float64)
    z = x * x / (4 * FOCAL)
    beta_0, beta = np.arctan2(-x, FOCAL - z), np.arctan2(offset_x - x, FOCAL + offset_z - z)
    half = np.arcsin(0.035 / np.hypot(offset_x - x, FOCAL + offset_z - z))
    middle = 2 * mirror.theta_r_rad(x, y) + beta_0 - beta
    # The table of errors joins them by straight lines: exact for these but for 1/32 of its step.
    within = 3e-6
    for side in (-1, 1):
        assert sees_absorber(tracer, x, y, middle + side * (half - within), along).all()
        assert not sees_absorber(tracer, x, y, middle + side * (half + within), along).any()
    # Negative control: the sign as printed in the thesis is refused.
    assert not sees_absorber(tracer, x, y, 2 * mirror.theta_r_rad(x, y) - beta_0 + beta + 0.8 * half, along).all()


@pytest.mark.parametrize("along", [0.0, 0.25])
def test_a_tilted_absorber_is_met_where_a_ray_comes_nearest(
    places: tuple[FloatArray, FloatArray], along: float
) -> None:
    x, y = places
    slope_x, slope_z = 0.02, -0.01
    receiver = Receiver(BARE, TubeAxis.straight(0.0, 0.0, slope_x, slope_z), has_arms=False)
    tracer = Tracer(world_of(TroughMirror(BARE), receiver, finish=BLACK), np.float64)
    z = x * x / (4 * FOCAL)
    # Circles normal to y about the axis: the squared distance from the middle of the circle where the ray is, is
    # quadratic along the ray; its least value follows from three of them.
    t = np.array([[0.0], [2.0], [4.0]])
    middle = np.arctan2(-x, FOCAL - z) - np.arctan2(slope_x * y - x, FOCAL + slope_z * y - z)
    for k in (5, 40, 70, 110):
        # Within 60 mrad of the middle one edge lies on either side.
        phi = np.linspace(middle[k] - 0.06, middle[k] + 0.06, 2001)
        beta = -2 * np.arctan(x[k] / (2 * FOCAL)) - phi
        at_x, at_y, at_z = x[k] + t * np.sin(beta), y[k] - t * along, z[k] + t * np.cos(beta)
        first, second, third = (at_x - slope_x * at_y) ** 2 + (at_z - FOCAL - slope_z * at_y) ** 2
        a, b = (first - 2 * second + third) / 8, (4 * second - 3 * first - third) / 4
        inside = first - b * b / (4 * a) < 0.035**2
        assert not inside[[0, -1]].any()
        assert inside.any()
        seen = sees_absorber(tracer, np.full(2001, x[k]), np.full(2001, y[k]), phi, along)
        np.testing.assert_array_equal(seen, inside)


def test_a_tilted_absorber_shifts_the_edges(places: tuple[FloatArray, FloatArray]) -> None:
    x, y = places
    receiver = Receiver(BARE, TubeAxis.straight(0.0, 0.0, 2e-3, -1e-3))
    tracer = Tracer(world_of(TroughMirror(BARE), receiver, finish=BLACK), np.float64)
    z = x * x / (4 * FOCAL)
    beta_0, beta = np.arctan2(-x, FOCAL - z), np.arctan2(2e-3 * y - x, FOCAL - 1e-3 * y - z)
    half = np.arcsin(0.035 / np.hypot(2e-3 * y - x, FOCAL - 1e-3 * y - z))
    for side in (-1, 1):
        assert sees_absorber(tracer, x, y, beta_0 - beta + side * (half - 2e-6), 0.0).all()
        assert not sees_absorber(tracer, x, y, beta_0 - beta + side * (half + 2e-6), 0.0).any()


def test_longitudinal_slope_turns_the_normal_along(places: tuple[FloatArray, FloatArray]) -> None:
    # Reflection in space by the kernel's own vector law; the renderer's is written for slopes.
    x, y = places
    mirror = TroughMirror(BARE, errors=SurfaceErrors((Ripple(3e-3, 1.0, 0.6),)))
    table = Tracer(world_of(mirror), np.float64).mirror
    points = np.stack([x, y, x * x / (4 * FOCAL)], axis=1)
    cameras = points + np.array([1.0, 2.0, 14.0])
    from data_synth.troughs.trace import _reflected

    rays = rays_between(cameras, points)
    turned = _reflected(table, rays, table.meet(rays), table.panel(x, y))
    _, error_x, error_y = mirror.deviation(x, y)
    normals = np.stack([-x / (2 * FOCAL) - error_x, -error_y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = reflect(points - cameras, normals)
    np.testing.assert_allclose(np.stack(turned[3:], axis=1) / 14, expected / 14, atol=8e-6)


def through_glass_in_space(start: FloatArray, direction: FloatArray, design: Collector) -> FloatArray:
    """Return the direction between glass and absorber by refraction at two cylinders in space."""
    assert design.glass is not None
    point, ray, before = start, direction / np.linalg.norm(direction), 1.0
    faces = ((design.glass.outer_diameter_m / 2, design.glass.index), (design.glass.inner_diameter_m / 2, 1.0))
    for radius, behind in faces:
        a, b = ray[0] ** 2 + ray[2] ** 2, point[0] * ray[0] + point[2] * ray[2]
        c = point[0] ** 2 + point[2] ** 2 - radius**2
        point = point + (-b - np.sqrt(b * b - a * c)) / a * ray
        normal = np.array([point[0], 0.0, point[2]]) / radius
        ray = refract(ray, normal, before, behind)
        before = behind
    return np.array([*point, *ray])


def test_glass_refracts_as_in_space() -> None:
    design = ls2()
    offset = (3e-3, -5e-3)
    receiver = Receiver(design, TubeAxis.straight(*offset), TubeAxis.straight())
    table = ReceiverTable(receiver, np.float64)
    rng = np.random.default_rng(1)
    for _ in range(30):
        aim = rng.uniform(-0.045, 0.045)
        start = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), 3.0])
        direction = np.array([aim - start[0], rng.uniform(-0.6, 0.6), -start[2]])
        rays = rays_between((start + (0, 0, FOCAL))[None], (start + direction + (0, 0, FOCAL))[None])
        inside = table.enter(table.approach(rays))
        line = through_glass_in_space(start, direction, design)
        # Signed distance of the absorber's axis from the refracted line, in the transverse plane.
        across = np.hypot(line[3], line[5])
        expected = ((line[0] - offset[0]) * line[5] - (line[2] - offset[1]) * line[3]) / across
        assert inside.offset[0] * 0.035 == pytest.approx(expected, abs=1e-9)


def test_refraction_moves_a_displaced_absorber_by_less_than_a_tenth_of_a_millimetre() -> None:
    # Owkes 2012, sec. 7.2.2 (V2): absorber (3, -5) mm, seen under 45 deg, with and without glass.
    design = ls2()
    receiver = Receiver(design, TubeAxis.straight(3e-3, -5e-3), TubeAxis.straight())
    table = ReceiverTable(receiver, np.float64)
    for side in (-1, 1):
        camera = np.array([side * 7.0, 0.0, 7.0])
        toward = np.array([0.003, 0.0, FOCAL - 0.005]) - camera
        right = np.array([toward[2], 0.0, -toward[0]]) / np.hypot(toward[0], toward[2])
        edges = []
        shift = np.linspace(-0.04, 0.04, 80001)
        points = camera + toward + shift[:, None] * right
        passage = table.approach(rays_between(np.broadcast_to(camera, points.shape), points))
        hit = passage.which[table.enter(passage).on_absorber]
        edges = shift[hit.min()], shift[hit.max()]
        assert abs(sum(edges)) / 2 < 1e-4
        assert abs(sum(edges)) / 2 > 5e-6
        assert edges[1] - edges[0] == pytest.approx(0.07, abs=2e-4)


def fresnel(cos_in: float, before: float, behind: float) -> float:
    """Reflectance of unpolarised light by Fresnel's amplitudes; 1 beyond total reflection."""
    sine = before / behind * np.sqrt(max(1 - cos_in**2, 0))
    if sine >= 1:
        return 1.0
    cos_out = np.sqrt(1 - sine**2)
    across = (before * cos_in - behind * cos_out) / (before * cos_in + behind * cos_out)
    along = (behind * cos_in - before * cos_out) / (behind * cos_in + before * cos_out)
    return float(across**2 + along**2) / 2


def split_at_faces(
    point: FloatArray, ray: FloatArray, share: float, bounces: int, absorber: tuple[float, float], design: Collector
) -> list[tuple[float, FloatArray | None]]:
    """Follow a ray in space, split in two at each face; share of each end and its direction, None on the absorber."""
    assert design.glass is not None
    outer, inner = design.glass.outer_diameter_m / 2, design.glass.inner_diameter_m / 2
    nearest: tuple[float, str] = (np.inf, "")
    for name, radius, (x, z) in (
        ("outer", outer, (0.0, 0.0)),
        ("inner", inner, (0.0, 0.0)),
        ("metal", design.absorber_diameter_m / 2, absorber),
    ):
        from_x, from_z = point[0] - x, point[2] - z
        a, b = ray[0] ** 2 + ray[2] ** 2, from_x * ray[0] + from_z * ray[2]
        root = b * b - a * (from_x**2 + from_z**2 - radius**2)
        if root <= 0:
            continue
        for length in ((-b - np.sqrt(root)) / a, (-b + np.sqrt(root)) / a):
            if length > 1e-9 and length < nearest[0]:
                nearest = (length, name)
    length, name = nearest
    if not name:
        return [(share, ray)]
    if name == "metal":
        return [(share, None)]
    met = point + length * ray
    normal = np.array([met[0], 0.0, met[2]]) / np.hypot(met[0], met[2])
    inwards = ray @ normal < 0
    before, behind = (1.0, design.glass.index) if inwards == (name == "outer") else (design.glass.index, 1.0)
    lost = fresnel(abs(float(ray @ normal)), before, behind)
    found = []
    if lost < 1:
        found += split_at_faces(
            met, refract(ray, normal, before, behind), share * (1 - lost), bounces, absorber, design
        )
    if bounces < 2 or lost == 1:
        back = ray - 2 * (ray @ normal) * normal
        found += split_at_faces(met, back, share * lost, bounces + (lost < 1), absorber, design)
    return found


@pytest.mark.parametrize("absorber", [(0.0, 0.0), (4e-3, -3e-3)])
@pytest.mark.parametrize("along", [0.0, 0.5])
def test_glass_shares_light_as_rays_split_at_each_face(absorber: tuple[float, float], along: float) -> None:
    design = ls2()
    table = ReceiverTable(Receiver(design, TubeAxis.straight(*absorber), TubeAxis.straight()), np.float64)
    turn = 0.3
    down, right = np.array([np.sin(turn), along, -np.cos(turn)]), np.array([np.cos(turn), 0.0, np.sin(turn)])
    seen_far = 0
    for aim in np.linspace(-0.055, 0.055, 44):
        start = aim * right - 3 * down
        rays = rays_between((start + (0, 0, FOCAL))[None], (start + down + (0, 0, FOCAL))[None])
        passage = table.approach(rays)
        inside = table.enter(passage)
        if abs(abs(inside.offset[0]) - 1) < 0.02:
            continue
        ends = split_at_faces(start, down / np.linalg.norm(down), 1.0, 0, absorber, design)
        ways = [(inside.passed[0], inside.turned[0], inside.on_absorber[0])]
        ways += [(one.share[0], one.turned[0], one.on_absorber[0]) for one in inside.thrown_back]
        seen_far += len(ends) > 8
        missed = 1.0
        for share, turned, is_absorber in ways:
            if share < 1e-9:
                continue
            out = table.leave(passage, np.array([turned]), rays)
            way = np.array([out.dx[0], out.dy[0], out.dz[0]]) / np.linalg.norm(down)
            alike = [
                k
                for k, (_, end) in enumerate(ends)
                if ((end is None) if is_absorber else (end is not None and np.abs(end - way).max() < 1e-9))
            ]
            # Several ends are on the absorber: the one with this share is meant.
            best = min(alike, key=lambda k: abs(ends[k][0] - share))
            assert ends[best][0] == pytest.approx(share, rel=1e-9)
            missed -= ends.pop(best)[0]
        # Six pairs of faces reflect twice, each the product of two reflectances.
        if abs(aim) < 0.048:
            assert 0 <= missed < 7 * inside.thrown_back[0].share[0] ** 2
    assert seen_far > 10


def test_light_beside_the_metal_is_the_background_through_two_walls() -> None:
    # An even sky everywhere: glass takes nothing from it but what it shows of the metal.
    design = ls2()
    sky = Surroundings(Sky(zenith=1.0, horizon=1.0, aureole=0.0, sun_elevation_deg=-80.0))
    finish = replace(BLACK, reflectance=1.0)
    receiver = Receiver(design, TubeAxis.straight(), has_arms=False)
    tracer = Tracer(world_of(TroughMirror(design), receiver, sky, finish), np.float64)
    # Seen under 30 degrees they pass the axis at 0, 39 and 45 mm.
    x = np.array([0.0, 0.045, 0.052])
    eyes = np.stack([x + 7.0, np.full(3, 1.2), np.full(3, FOCAL + 12.0)], axis=1)
    points = np.stack([x, np.full(3, 1.2), np.full(3, FOCAL)], axis=1)
    light = tracer.look(rays_between(eyes, points)).light
    # On the metal both faces of the near wall at normal incidence.
    lost = (0.47 / 2.47) ** 2
    assert light[0] == pytest.approx(lost + (1 - lost) ** 2 * lost, abs=1e-3)
    assert light[1:] == pytest.approx(1.0, abs=0.02)
