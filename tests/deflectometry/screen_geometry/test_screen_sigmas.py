"""Sigmas of a screen and of the measuring camera's pose against the scatter of many drawn sets of image points.

The image points are those of the drawn scene's own projection: corners where four edges meet that each have an error,
centres of the ellipses that round dots show.
"""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_synth.optics.photo import View
from data_synth.screens import ScreenChoice, screen_scene
from data_synth.screens.scene import BENCH_PHOTO, DICTIONARY, ScreenScene
from deflectometry.dots.found_dots import FoundDots
from deflectometry.screen_geometry import MeasuredScreen, load_screen
from deflectometry.screen_geometry.keys import ScreenGeometryModel
from deflectometry.screen_geometry.pipeline.network import Seen, solve
from deflectometry.screen_geometry.planning.plan import PlannedScreen
from deflectometry.screen_geometry.screen_shape import describe_display, describe_dots
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.load import read_measurement
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.tables import write_table_csv
from heliogauge.running.progress import SilentProgress
from heliogauge.validate import FloatArray
from photogrammetry import ImagePoints
from photogrammetry.pipeline import MeasuredPhotos

pytestmark = pytest.mark.slow

#: Error of an edge's line in its middle, and of a dot's centre [px].
_EDGE_PX, _DOT_PX = 0.005, 0.003
#: Columns and rows of the field that take part: every third dot of 30 x 20.
_EVERY = 3


def _corners(view: View, points: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return where the edges of a marker meet: each is off by a shift and a turn, as of a line through many pixels."""
    seen = view.project(points)
    lines = []
    for a, b in zip(seen, np.roll(seen, -1, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
        shift, turn = _EDGE_PX * rng.standard_normal(), np.sqrt(3) * _EDGE_PX * rng.standard_normal()
        lines.append(np.cross([*(a + (shift - turn) * normal), 1.0], [*(b + (shift + turn) * normal), 1.0]))
    meet = [np.cross(before, after) for before, after in zip(np.roll(lines, 1, axis=0), lines, strict=True)]
    return np.array([one[:2] / one[2] for one in meet])


def _ellipses(view: View, drawn: ScreenScene) -> tuple[FloatArray, FloatArray]:
    """Return centre and shape of the ellipse through the image of each dot's outline, exact."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    outline = view.project(drawn.shape.points_m(drawn.dots_m[:, None] + drawn.radii_m[:, None, None] * around))
    middle = outline.mean(axis=1, keepdims=True)
    x, y = np.moveaxis(outline - middle, -1, 0)
    conic = np.linalg.pinv(np.stack([x * x, 2 * x * y, y * y, x, y], axis=-1)) @ np.ones((len(x), 16, 1))
    a, b, c, d, e = conic[..., 0].T
    matrix = np.stack([np.stack([a, b], -1), np.stack([b, c], -1)], -2)
    off = -0.5 * np.linalg.solve(matrix, np.stack([d, e], -1)[..., None])[..., 0]
    size = 1 + np.einsum("ni,nij,nj->n", off, matrix, off)
    return middle[:, 0] + off, np.linalg.inv(matrix / size[:, None, None])


def _folder(folder: Path, drawn: ScreenScene, *, dots: bool) -> None:
    """Write what a measurement folder says; its photos are never read."""
    folder.mkdir()
    for view in drawn.scene.views:
        (folder / f"{view.name}.png").write_bytes(b"")
    bench = drawn.scene.views[-1].camera
    content = {
        "kind": "screen-geometry",
        "name": "screen",
        "camera": [
            # A rounded focal length, as the photos of a camera state it.
            {"name": "survey", "focal_length_35mm": 39.0},
            {
                "name": "measuring",
                "photos": [f"{BENCH_PHOTO}.png"],
                "width_px": bench.width_px,
                "height_px": bench.height_px,
                "focal_px": bench.focal_y_px,
                "center_x_px": bench.center_x_px,
                "center_y_px": bench.center_y_px,
            },
        ],
        "images": {"photos": "photo_*.png"},
        "measuring_photo": f"{BENCH_PHOTO}.png",
        "targets": {"dictionary": DICTIONARY},
        "scale_bar": [
            {"a": one.a, "b": one.b, "length_m": one.stated_m, "sigma_mm": 1e3 * one.sigma_m}
            for one in drawn.scene.lengths
        ],
    }
    if dots:
        content["dots"] = {"dots": "dark", "origin": "corner"}
    else:
        content["display"] = {"file": "targets.csv"}
        fractions = np.array(list(drawn.markers.values())).T
        table = {"target": np.array(list(drawn.markers)), "u": fractions[0], "v": fractions[1]}
        write_table_csv(folder / "targets.csv", table)
    write_measurement(folder, content)


def _seen(drawn: ScreenScene, rng: np.random.Generator) -> Seen:
    photos, targets, pixels = [], [], []
    dots: dict[str, FoundDots] = {}
    points = drawn.scene.points_m()
    for view in drawn.scene.views:
        name, size = f"{view.name}.png", np.array([view.camera.width_px, view.camera.height_px])
        for number in drawn.markers:
            names = [f"{number}.{k}" for k in range(4)]
            corners = _corners(view, np.array([points[one] for one in names]), rng)
            if (corners > 5).all() and (corners < size - 5).all():
                photos += [name] * 4
                targets += names
                pixels.append(corners)
        if len(drawn.dots_m):
            column, row = _numbers(drawn.dots_m)
            centers, shapes = _ellipses(view, drawn)
            chosen = (column % _EVERY == 0) & (row % _EVERY == 0)
            chosen &= (centers > 10).all(axis=1) & (centers < size - 10).all(axis=1)
            count = int(chosen.sum())
            number = np.stack([column, -row], axis=1)[chosen] // _EVERY
            dots[name] = FoundDots(
                centers[chosen] + _DOT_PX * rng.standard_normal((count, 2)),
                np.tile(_DOT_PX**2 * np.eye(2), (count, 1, 1)),
                number,
                np.full(count, 100.0),
                1.0,
                0,
                shapes[chosen],
            )
    covariance = np.tile((2 * _EDGE_PX) ** 2 * np.eye(2), (len(targets), 1, 1))
    table = ImagePoints.from_names(photos, targets, np.concatenate(pixels), covariance)
    sizes = {f"{one.name}.png": (one.camera.width_px, one.camera.height_px) for one in drawn.scene.views}
    shapes = np.full((table.n, 2, 2), np.nan)
    return Seen(MeasuredPhotos(table, shapes, sizes, (), (), True), dots, {}, ())


def _numbers(dots_m: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    step = float(np.diff(np.unique(np.round(dots_m[:, 0], 9)))[0])
    column, row = np.rint((dots_m - dots_m.min(axis=0)) / step).astype(np.intp).T
    return column, row


def _aligned(points_m: FloatArray, truth_m: FloatArray) -> RigidTransform:
    a, b = truth_m.mean(axis=0), points_m.mean(axis=0)
    u, _, v = np.linalg.svd((truth_m - a).T @ (points_m - b))
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
    return RigidTransform(turn, b - turn @ a)


def _errors(measured: MeasuredScreen, drawn: ScreenScene) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return places u, v, errors of the points (n, 3) and of the measuring camera's pose (6,), in its frame."""
    screen = measured.screen
    if isinstance(screen, DotScreen):
        row, column = np.nonzero(np.isfinite(screen.xyz_m[..., 0]))
        rows, columns = screen.shape
        u, v, found = column / (columns - 1), row / (rows - 1), screen.xyz_m[row, column]
        low = drawn.dots_m.min(axis=0)
        pitch = (drawn.dots_m[:, 0].max() - low[0]) / 29
        places = np.stack([low[0] + _EVERY * pitch * column, low[1] + _EVERY * pitch * (rows - 1 - row)], axis=1)
    else:
        u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
        found = screen.points_m(u, v)
        places = np.stack([(u - 0.5) * drawn.size_m[0], (0.5 - v) * drawn.size_m[1]], axis=1)
    truth = drawn.shape.points_m(places)
    place = _aligned(found, truth)
    assert measured.cam_from_screen is not None
    bench = drawn.scene.views[-1].cam_from_world @ place.inverse()
    turn = RigidTransform(measured.cam_from_screen.rotation @ bench.rotation.T, np.zeros(3)).rotation_vector_rad
    pose = np.concatenate([turn, measured.cam_from_screen.translation_m - bench.translation_m])
    return u, v, found - place.apply(truth), pose


def _joint(measured: MeasuredScreen, u: FloatArray, v: FloatArray, points: FloatArray, pose: FloatArray) -> float:
    """Return the squares of errors of pose and points, whitened by their joint covariance; of dots their own, too."""
    modes = np.array(
        [np.concatenate([one.warp.shifts_m(u, v).ravel(), one.cam_from_screen]) for one in measured.shared]
    )
    every = np.concatenate([points.ravel(), pose])
    if isinstance(measured.screen, DotScreen):
        # Points of their own errors: C = D + M M^T, the pose is all shared.
        variance = np.concatenate([measured.screen.sigma_at(u, v).ravel() ** 2, 1e-4 * (modes[:, -6:] ** 2).sum(0)])
        white, shared = every / np.sqrt(variance), modes / np.sqrt(variance)
        inner = np.eye(len(shared)) + shared @ shared.T
        square = float(white @ white - (shared @ white) @ np.linalg.solve(inner, shared @ white))
        return square / (every.size - 6)
    scale = np.sqrt((modes**2).sum(axis=0))
    _, values, vectors = np.linalg.svd(modes / scale, full_matrices=False)
    keep = values > 1e-5 * values[0]
    return float(np.mean((vectors[keep] @ (every / scale) / values[keep]) ** 2))


def _sigmas(measured: MeasuredScreen, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the sigmas of points in x, y, z and of the camera's turn and place, RMS, shape (5,)."""
    pose = np.diag(measured.covariance_pose)
    points = np.mean(measured.sigma_points_m(u, v) ** 2, axis=0)
    return np.sqrt([*points, np.mean(pose[:3]), np.mean(pose[3:])])


def _promised(folder: Path, drawn: ScreenScene) -> MeasuredScreen:
    """Return what a plan says that knows size, sag, targets and places of a scene, not how its cameras are turned."""
    size, middle = np.array(drawn.size_m), np.zeros(2)
    plan: dict[str, Any] = {}
    if len(drawn.dots_m):
        column, row = _numbers(drawn.dots_m)
        dots = drawn.dots_m[(column % _EVERY == 0) & (row % _EVERY == 0)]
        size, middle = np.ptp(dots, axis=0), 0.5 * (dots.min(axis=0) + dots.max(axis=0))
        plan = {"columns": 10, "rows": 7, "targets": "around.csv"}
        places = {
            name: 0.5 + ((np.array([u, 1 - v]) - 0.5) * drawn.size_m - middle) / size
            for name, (u, v) in drawn.markers.items()
        }
        around = np.array(list(places.values())).T
        write_table_csv(folder / "around.csv", {"target": np.array(list(places)), "u": around[0], "v": 1 - around[1]})
    centers = np.array([one.cam_from_world.inverse().translation_m for one in drawn.scene.views]) - [*middle, 0.0]
    plan |= {
        "width_m": float(size[0]),
        "height_m": float(size[1]),
        "sag_mm": 1e3 * float(drawn.shape.bending_per_m[0]) * (0.5 * float(size[0])) ** 2,
        "places_m": centers[:-1].tolist(),
        "measuring_place_m": centers[-1].tolist(),
        "sigma_target_px": 2 * _EDGE_PX,
        "sigma_dot_px": _DOT_PX,
    }
    content = tomllib.loads((folder / "measurement.toml").read_text()) | {"plan": plan}
    sizes = {one.camera.width_px: one.camera.height_px for one in drawn.scene.views}
    content["camera"][0] |= {"width_px": max(sizes), "height_px": sizes[max(sizes)]}
    content["shape"] = {"form": "free"}
    write_measurement(folder, content)
    planned = PlannedScreen(folder, read_measurement(folder, ScreenGeometryModel)[1])
    return planned.measured(planned.surface(), planned.photos()).measured


@pytest.mark.parametrize("show", ["rims", "dots"])
def test_points_and_measuring_camera_scatter_as_stated_and_as_planned(show: str, tmp_path: Path) -> None:
    """Ten sets: pose and what the points share, whitened by their joint covariance; for dots their own errors too."""
    joint, poses, errors, stated = [], [], [], []
    for seed in range(10):
        drawn = screen_scene(ScreenChoice(show, seed))  # type: ignore[arg-type]
        _folder(tmp_path / str(seed), drawn, dots=show == "dots")
        measurement = load_screen(tmp_path / str(seed))
        network = solve(measurement, _seen(drawn, np.random.default_rng([seed, 7])), SilentProgress())
        if show == "dots":
            measured = describe_dots(network.points, network.number, own_frame=True)
        else:
            measured = describe_display(network.points, "auto", own_frame=True)[0]
        found = _errors(measured, drawn)
        poses.append(float(found[-1] @ np.linalg.solve(measured.covariance_pose, found[-1])) / 6)
        joint.append(_joint(measured, *found))
        errors.append(found)
        stated.append(_sigmas(measured, *found[:2]))
    assert 0.8 < np.mean(joint) < 1.25
    # Sixty numbers: outside of this with a chance of 1e-2.
    assert 0.6 < np.mean(poses) < 1.52
    promised = _promised(tmp_path / "0", screen_scene(ScreenChoice(show, 0)))  # type: ignore[arg-type]
    assert 0.8 < np.mean([_joint(promised, *one) for one in errors]) < 1.25
    every_stated = np.sqrt(np.mean(np.square(stated), axis=0))
    assert _sigmas(promised, *errors[0][:2]) == pytest.approx(every_stated, rel=0.1)
