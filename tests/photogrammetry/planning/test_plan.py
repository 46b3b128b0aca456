"""Planned networks: what is predicted is what a measurement of that plan reports, and weak plans say so."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import looking_at
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.templates import write_template
from heliogauge.results.folder import read_cameras_json, read_points_csv, read_summary, read_table_csv
from photogrammetry.bundle.constraints import Distance
from photogrammetry.cli import app
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.pipeline import measure as pipeline
from photogrammetry.planning.keys import load_photogrammetry_plan
from photogrammetry.planning.network_design import Goal, Task, plan_network
from photogrammetry.planning.planned_network import PlannedCamera, predict, q_factor
from photogrammetry.planning.stations import (
    PlannedObject,
    Reach,
    aims_m,
    filling_distance_m,
    ring_stations,
    seen_targets,
)

CAMERA = Camera(3000, 2000, 3000.0, 3000.0, 1499.5, 999.5)
FREE = ("focal_px", "center_x_px", "center_y_px", "k1", "k2")
UP = np.array([0.0, 0.0, 1.0])


def panel(columns=7, rows=5, width=2.0, height=1.4, diameter_m=0.0):
    """A curved panel with its normals."""
    x, y = (
        axis.ravel()
        for axis in np.meshgrid(np.linspace(-0.5, 0.5, columns) * width, np.linspace(-0.5, 0.5, rows) * height)
    )
    points = np.stack([x, y, x**2 / 8], axis=1)
    normals = np.stack([-x / 4, 0 * x, np.ones_like(x)], axis=1)
    return PlannedObject(tuple(str(i + 1) for i in range(x.size)), points, normals, diameter_m)


def bars_of(target_object):
    a, b = target_object.points_m[0], target_object.points_m[-1]
    return (Distance(target_object.names[0], target_object.names[-1], float(np.linalg.norm(a - b)), 1e-5),)


def task_of(sigma_m=3e-5, **changes):
    target_object = panel()
    task = Task(
        target_object,
        PlannedCamera(CAMERA, FREE, 0.04),
        Reach(filling_distance_m(target_object, CAMERA)),
        Goal(sigma_m),
        bars_of(target_object),
    )
    return replace(task, **changes)


LAYOUTS = [(np.radians(35.0),), (np.radians(20.0), np.radians(50.0))]


def test_turned_camera_sees_its_right_side_down() -> None:
    upright = looking_at(np.array([0.0, -5.0, 0.0]), np.zeros(3), UP)
    np.testing.assert_allclose(upright.apply(np.array([[1.0, 0.0, 2.0]])), [[1.0, -2.0, 5.0]], atol=1e-12)
    # Clockwise seen from behind: what was up in the image lies to the left.
    turned = looking_at(np.array([0.0, -5.0, 0.0]), np.zeros(3), UP, np.pi / 2)
    np.testing.assert_allclose(turned.apply(np.array([[0.0, 0.0, 2.0]])), [[-2.0, 0.0, 5.0]], atol=1e-12)
    straight_down = looking_at(np.array([0.0, 0.0, 5.0]), np.zeros(3), UP)
    np.testing.assert_allclose(np.linalg.det(straight_down.rotation), 1.0)


def test_a_camera_sees_what_faces_it_inside_its_image_and_large_enough() -> None:
    names, normals = tuple("abcde"), np.array([[0, 0, 1.0]] * 3 + [[1.0, 0, 0.2]] + [[np.nan] * 3])
    points = np.array([[0.0, 0, 0], [3.0, 0, 0], [0, 0, 9.0], [0.1, 0, 0], [-0.1, 0, 0]])
    targets = PlannedObject(names, points, normals, 0.01)
    pose = looking_at(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    seen, pixels = seen_targets(targets, CAMERA, pose, Reach(5.0))
    # Middle; outside; behind; turned away by 78 degrees; a ball that is seen from everywhere.
    assert seen.tolist() == [True, False, False, False, True]
    np.testing.assert_allclose(pixels[0], [1499.5, 999.5])
    assert not seen_targets(targets, CAMERA, pose, Reach(5.0), 6.1)[0].any()


def test_the_object_fills_the_image_from_every_side() -> None:
    targets = panel()
    reach = Reach(filling_distance_m(targets, CAMERA), incidence_rad=np.radians(89))
    for ring in (0.0, 30.0, 60.0):
        for station in ring_stations(
            targets, aims_m(targets, CAMERA, reach.distance_m), reach, (np.radians(ring),), 12
        ):
            seen, pixels = seen_targets(targets, CAMERA, station.cam_from_world, reach)
            assert seen.all()
            assert np.ptp(pixels, axis=0).max() > 0.55 * CAMERA.height_px


def test_heights_that_cannot_be_reached_are_left_out() -> None:
    targets = panel()
    reach = Reach(3.0, up=(0.0, 1.0, 0.0), lowest_m=-0.2, highest_m=1.0)
    stations = ring_stations(targets, targets.center_m[None], reach, (np.radians(40.0),), 10)
    heights = [one.center_m[1] for one in stations]
    assert len(heights) == 10
    assert min(heights) >= -0.2
    assert max(heights) <= 1.0
    high = replace(reach, lowest_m=5.0, highest_m=6.0)
    assert ring_stations(targets, targets.center_m[None], high, (np.radians(40.0),), 10) == ()


def test_rays_alone_are_the_planning_rule() -> None:
    """Four rays at 45 degrees from the normal give q = 0.62, as derived at `q_factor`."""
    targets = PlannedObject(
        tuple("abcd"), np.array([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3]]), np.full((4, 3), np.nan)
    )
    planned, reach = PlannedCamera(CAMERA, (), 0.05), Reach(4.0)
    stations = ring_stations(targets, targets.center_m[None], reach, (np.pi / 4,), 4)
    found = predict(targets, planned, stations, reach)
    scale = 4.0 / 3000 * 0.05
    # Each ray measures two of three directions: sums of 4 x 3/4 across and 4 x 1/2 along the normal of the ring.
    expected = scale * np.sqrt((1 / 3 + 1 / 3 + 1 / 2) / 3)
    assert np.sqrt((found.alone_m**2).mean()) == pytest.approx(expected, rel=2e-3)
    assert found.convergence_rad == pytest.approx(np.pi / 2, rel=1e-2)


def test_more_photos_are_better_by_the_square_root() -> None:
    task = task_of()
    sigma = []
    for count in (12, 48):
        stations = ring_stations(task.target_object, task.target_object.center_m[None], task.reach, LAYOUTS[1], count)
        sigma.append(predict(task.target_object, task.planned, stations, task.reach).rms_m)
    assert sigma[0] / sigma[1] == pytest.approx(2.0, rel=0.1)


def test_a_plan_keeps_its_goal_with_the_fewest_photos() -> None:
    task = task_of()
    plan = plan_network(task, LAYOUTS)
    assert plan.reached
    assert plan.best.prediction.rms_m <= 3e-5
    assert 0.4 < plan.q < 0.9
    fewer = [one for one in plan.trials if one.rings_rad == plan.best.rings_rad and one.count == plan.best.count - 1]
    assert all(one.prediction.rms_m > 3e-5 for one in fewer)
    assert len(fewer) == 1
    largest = plan_network(replace(task, goal=Goal(3e-5, of_largest=True)), LAYOUTS)
    assert largest.best.count > plan.best.count
    assert largest.best.prediction.largest_m <= 3e-5


def test_an_object_larger_than_the_image_is_divided() -> None:
    targets = panel(17, 9, 6.0, 3.0)
    reach = Reach(0.45 * filling_distance_m(targets, CAMERA))
    assert len(aims_m(targets, CAMERA, reach.distance_m)) > 3
    task = Task(targets, PlannedCamera(CAMERA, FREE, 0.04), reach, Goal(1e-4), bars_of(targets))
    plan = plan_network(task, LAYOUTS)
    assert plan.reached
    assert plan.best.prediction.rays.min() >= 3
    assert plan.best.prediction.rays.max() < plan.best.count


@pytest.mark.parametrize(
    ("changes", "layouts", "code"),
    [
        ({"reach": Reach(3.5, turned=False)}, LAYOUTS, "plan_camera_never_turned"),
        ({"planned": PlannedCamera(CAMERA, (), 0.04)}, [(np.radians(8.0),)], "plan_depth_weak"),
        ({}, [(np.radians(8.0),)], "plan_convergence_weak"),
        ({"bars": ()}, LAYOUTS, "plan_without_scale_bar"),
        ({"goal": Goal(1e-7, most_photos=8)}, LAYOUTS, "plan_goal_not_reached"),
        ({"reach": Reach(12.0)}, LAYOUTS, "plan_coverage_poor"),
    ],
)
def test_weak_plans_say_so(changes, layouts, code) -> None:
    plan = plan_network(task_of(6e-5, **changes), layouts)
    assert code in [one.code for one in plan.doubts]


def test_a_strong_plan_has_no_doubts() -> None:
    assert plan_network(task_of(), LAYOUTS).doubts == ()


def test_nothing_to_see_is_refused() -> None:
    away = replace(task_of(), reach=Reach(3.5, incidence_rad=np.radians(5.0)), goal=Goal(1e-4, most_photos=6))
    with pytest.raises(EstimationError, match="none of 4 networks determines all targets"):
        plan_network(away, LAYOUTS)


def measured_like_planned(task, plan, folder: Path, seed: int):
    """Write image points of a plan with noise, as another program would have measured them, and evaluate them."""
    rng, stations = np.random.default_rng(seed), plan.best.prediction.stations
    lines = ["image,target,x_px,y_px,sigma_x_px,sigma_y_px"]
    for number, station in enumerate(stations):
        seen, pixels = seen_targets(task.target_object, CAMERA, station.cam_from_world, task.reach)
        for i in np.nonzero(seen)[0]:
            x, y = pixels[i] + rng.normal(0, 0.04, 2)
            lines.append(f"p{number},{task.target_object.names[i]},{x:.6f},{y:.6f},0.04,0.04")
    (folder / "image_points.csv").write_text("\n".join(lines) + "\n")
    bar = task.bars[0]
    (folder / "measurement.toml").write_text(
        'kind = "photogrammetry"\nname = "as planned"\n[camera]\nwidth_px = 3000\nheight_px = 2000\n'
        f'focal_px = 2950.0\nfree = {list(FREE)}\n[image_points]\n[[scale_bar]]\na = "{bar.target_a}"\n'
        f'b = "{bar.target_b}"\nlength_m = {bar.distance_m!r}\nsigma_mm = 0.01\n'.replace("'", '"')
    )
    return pipeline.run(load_photogrammetry(folder))


def test_a_measurement_reports_what_was_planned(tmp_path: Path) -> None:
    task = task_of()
    plan = plan_network(task, LAYOUTS)
    bundle = measured_like_planned(task, plan, tmp_path, 7).solved.bundle
    order = [bundle.problem.observations.targets.index(name) for name in task.target_object.names]
    planned, reported = plan.best.prediction, bundle.sigma_points_m[order]
    # The frame of the measurement is its own: sums over the three axes do not depend on it.
    np.testing.assert_allclose(np.sqrt((reported**2).sum(axis=1)), np.sqrt((planned.sigma_m**2).sum(axis=1)), rtol=0.02)
    # And the coordinates scatter as planned, after the best fit that the datum leaves open.
    own = bundle.points_m[order] - bundle.points_m[order].mean(axis=0)
    true = task.target_object.points_m - task.target_object.points_m.mean(axis=0)
    left, _, right = np.linalg.svd(own.T @ true)
    errors = own @ (left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right) - true
    ratio = float(np.sqrt((errors**2).sum() / (planned.sigma_m**2).sum()))
    assert 0.75 < ratio < 1.3


def test_the_command_writes_a_plan(tmp_path: Path) -> None:
    write_template("photogrammetry-plan", tmp_path / "plan")
    answer = CliRunner().invoke(app, ["plan", str(tmp_path / "plan"), "-o", str(tmp_path / "out"), "--no-report", "-q"])
    assert answer.exit_code == 0, answer.output
    summary = read_summary(tmp_path / "out")
    stations = read_table_csv(tmp_path / "out" / "stations.csv")
    count = summary.numbers["photos_count"]
    assert len(stations["name"]) == count
    assert set(stations["roll_deg"]) == {"0.0", "90.0"}
    points = read_points_csv(tmp_path / "out" / "points.csv")
    assert len(points.ids) == 66 + 2
    assert np.sqrt((points.sigma_m**2).mean()) == pytest.approx(summary.numbers["point_sigma_rms_m"])
    cameras, poses = read_cameras_json(tmp_path / "out" / "cameras.json")
    assert len(poses) == count
    assert cameras["camera"].sigma_parameters[0] > 0
    trials = read_table_csv(tmp_path / "out" / "trials.csv")
    assert trials["chosen"].count("1") == 1


def test_listed_targets_with_faces(tmp_path: Path) -> None:
    targets = panel()
    rows = [
        ",".join(map(str, [n, *p, *f]))
        for n, p, f in zip(targets.names, targets.points_m, targets.normals, strict=True)
    ]
    (tmp_path / "targets.csv").write_text("id,x_m,y_m,z_m,normal_x,normal_y,normal_z\n" + "\n".join(rows) + "\n")
    (tmp_path / "measurement.toml").write_text(
        'kind = "photogrammetry-plan"\nname = "a"\n[object]\ntargets = "targets.csv"\n[goal]\nsigma_mm = 0.05\n'
        "[camera]\nwidth_px = 3000\nheight_px = 2000\nfocal_px = 3000.0\nsigma_px = 0.04\n"
    )
    from photogrammetry.planning.plan import build_task

    task = build_task(load_photogrammetry_plan(tmp_path))
    np.testing.assert_allclose(task.target_object.points_m, targets.points_m)
    np.testing.assert_allclose(task.target_object.normals, targets.normals)
    assert task.planned.camera.center_x_px == 1499.5
    (tmp_path / "targets.csv").write_text("id,x_m,y_m,z_m\n1,0,0,\n")
    with pytest.raises(InputError, match="a coordinate is missing for target 1"):
        build_task(load_photogrammetry_plan(tmp_path))


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ('[object]\ndesign = "sphere"\nwidth_m = 1.0\nheight_m = 1.0\nspacing_m = 0.1\n', "needs radius_m"),
        ('[object]\ndesign = "plane"\ntargets = "a.csv"\n', "one of both"),
        ('[object]\ntargets = "a.csv"\n[stations]\nrings_deg = [95.0]\n', "rings_deg"),
        ('[object]\ntargets = "a.csv"\n[camera]\nsigma_px = 0.1\n', "give file, or width_px"),
    ],
)
def test_mistakes_in_a_plan(section, message) -> None:
    import tomllib

    content = {
        "kind": "photogrammetry-plan",
        "name": "a",
        "goal": {"sigma_mm": 0.1},
        "camera": {"width_px": 10, "height_px": 10, "focal_px": 10.0, "sigma_px": 0.1},
    }
    with pytest.raises(InputError, match=message):
        parse_measurement(content | tomllib.loads(section), Path("measurement.toml"))


def test_every_key_of_the_template_is_a_real_key(tmp_path: Path) -> None:
    import tomllib

    text = write_template("photogrammetry-plan", tmp_path).read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("#: file", "#: targets"))]
    parse_measurement(tomllib.loads("\n".join(lines).replace("#: ", "")), Path("full"))


def test_q_is_the_rule() -> None:
    task = task_of()
    stations = ring_stations(task.target_object, task.target_object.center_m[None], task.reach, LAYOUTS[1], 16)
    found = predict(task.target_object, task.planned, stations, task.reach, task.bars)
    away = np.mean([np.linalg.norm(one.center_m - task.target_object.points_m, axis=1).mean() for one in stations])
    rule = q_factor(found, task.planned, task.target_object) * away / 3000 * 0.04 / np.sqrt(16 / 4)
    assert rule == pytest.approx(found.rms_m, rel=1e-9)
