"""Plans of fringes, dots and far screens: what is promised is what is then measured, and what limits is named."""

import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from data_synth.fringes.knowledge import Knowledge, measurement_content
from data_synth.fringes.presets import ensemble_scene, preset_scene
from deflectometry.dots.planning.plan import PlannedDots, load_dots_plan
from deflectometry.dots.planning.predicted_dots import DotPlaces, measured_sample, places_of_dots
from deflectometry.fringes.planning.plan import PlannedFringes, load_fringes_plan
from deflectometry.planning.pipeline.alternatives import ALTERNATIVES_FILE, words_of_best
from deflectometry.planning.pipeline.bench import changed
from deflectometry.planning.pipeline.plan import LIMITS_FILE, MAP_FILE
from deflectometry.planning.predicted_sight import facet_sight, trace_pixels
from deflectometry.planning.prospect import LIMITED, Alternative, Change, PlannedSource, Prospect
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.folder import read_table_csv
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.running import cli
from photogrammetry.targets import Polarity
from tests.deflectometry.planning.promises import (
    KNOWLEDGE,
    drawn_dots,
    drawn_fringes,
    drawn_tower,
    joint_ratio,
    outcomes,
    promised_covariance,
)


def planned(folder: Path, knowledge: Knowledge = KNOWLEDGE, **changes: Any) -> Path:
    """Write the measurement.toml of a facet before a screen without any image; changes by tables."""
    folder.mkdir(exist_ok=True)
    scene = preset_scene("small")
    content = measurement_content(scene, ["later.png"] * scene.pattern.n_frames, knowledge, np.random.default_rng(0))
    content["plan"] = {"mirror_m": scene.bench.cam_from_mirror.translation_m.tolist(), "blur_px": 0.1}
    for table, values in changes.items():
        content[table] = {key: one for key, one in (content[table] | values).items() if one is not None}
    write_measurement(folder, content, comment="A plan.")
    return folder


def prospect(folder: Path) -> Prospect:
    return PlannedFringes(load_fringes_plan(folder)).prospect()


def plan_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the message with which ``deflectometry plan`` refuses a folder, and check that it leaves nothing."""
    out = folder.parent / "refused"
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(folder), "-o", str(out), "--no-report", "-q"])
    assert ended.value.code == 2
    assert not out.exists()
    return " ".join(capsys.readouterr().err.split())


def test_predicted_pixels_see_what_drawn_ones_see(tmp_path: Path) -> None:
    """Against the tracer of `data_synth` on the design: a hundredth of a millimetre on a screen of 9 m."""
    from dataclasses import replace

    scene = preset_scene("small")
    bare = replace(scene.facets[0], errors=type(scene.facets[0].errors)(()))
    bench = PlannedFringes(load_fringes_plan(planned(tmp_path / "p", Knowledge()))).bench
    sight = facet_sight(bench.setup, scene.bench.cam_from_mirror, bench.facets[0], 0.1)
    row, column = np.nonzero(sight.inside)
    x, y = column + float(sight.columns.start), row + float(sight.rows.start)
    traced = scene.bench.trace(bare, x, y)
    size = np.array([scene.bench.wall.width_m, scene.bench.wall.height_m])
    off = np.stack([sight.u[row, column] - traced.u, sight.v[row, column] - traced.v], axis=1) * size
    assert np.abs(off).max() < 1e-5


def test_the_mean_normal_is_limited_by_where_the_screen_is(tmp_path: Path) -> None:
    """A turn of the screen by 1 mrad turns the mean normal by as much, and hardly the slopes; the plan says so."""
    known = Knowledge(sigma_distance_mm=1.0, sigma_screen_rotation_mrad=1.0)
    found = prospect(planned(tmp_path / "p", known))
    limits = found.limits()
    assert limits["mean_normal"]["screen pose"] > 0.95
    assert found.sigmas()["mean_normal"] == pytest.approx(1e-3, rel=0.03)
    assert found.sigmas()["slope_x"] < 0.05 * found.sigmas()["mean_normal"]
    assert "the screen's turn about its y axis" in found.texts["mean normal"]
    assert "[mirror.place]" in found.texts["mean normal"]
    # A turn about one axis turns the normal about the other only by what rounding leaves.
    assert re.search(r"its y axis \([+-]1\.0, [+-]0\.0\)", found.texts["mean normal"])
    for shares in limits.values():
        assert sum(shares.values()) == pytest.approx(1.0)


def test_a_screen_that_is_too_small_is_named_with_the_size_it_needs(tmp_path: Path) -> None:
    """Of 8.7 m x 3.5 m the facet sees 2.5 m x 2.5 m around the middle: of 1.6 m of width it sees beyond both edges."""
    with pytest.raises(EstimationError, match="of the mirror sees the screen") as refused:
        prospect(planned(tmp_path / "p", screen={"width_m": 1.6}))
    said = str(refused.value)
    assert 50 < float(said.partition("%")[0]) < 80
    assert "left edge" in said
    assert "right edge" in said
    needed = float(said.partition("make it at least ")[2].split()[0])
    whole = prospect(planned(tmp_path / "q", screen={"width_m": needed}))
    assert whole.seen_share == 1.0


def test_a_plan_with_a_hole_is_refused_with_the_reason_of_which_the_hole_is_none(tmp_path: Path) -> None:
    """At nine times the distance the facet is too small in the image, whether or not its rim looks past the screen."""
    far = (9 * preset_scene("small").bench.cam_from_mirror.translation_m).tolist()
    for width_m, hole in ((8.727, False), (1.24, True)):
        with pytest.raises(EstimationError, match=r"px, \d+ are needed: come nearer") as refused:
            prospect(planned(tmp_path / "p", plan={"mirror_m": far}, screen={"width_m": width_m}))
        assert ("As planned, measuring would be refused: " in str(refused.value)) is hole


def test_the_stated_point_of_the_mirror_stands_at_the_stated_place(tmp_path: Path) -> None:
    point = [0.1, -0.1, 0.05]
    distance = {"distance": {"distance_m": 9.0, "sigma_mm": 1.0, "point_m": point}}
    bench = PlannedFringes(load_fringes_plan(planned(tmp_path / "p", plan={"mirror_m": None}, mirror=distance))).bench
    on_axis = bench.cam_from_mirror.apply(np.array(point))
    assert on_axis[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.linalg.norm(on_axis - bench.setup.cam_from_screen.translation_m) == pytest.approx(9.0)
    place = bench.setup.cam_from_screen.inverse().apply(np.array([0.1, -0.1, 9.0])).tolist()
    surveyed = {"place": {"place_m": place, "sigma_mm": 1.0, "point_m": point}, "distance": None}
    bench = PlannedFringes(load_fringes_plan(planned(tmp_path / "p", plan={"mirror_m": None}, mirror=surveyed))).bench
    assert bench.cam_from_mirror.apply(np.array(point)) == pytest.approx([0.1, -0.1, 9.0])


def test_stating_a_sigma_that_nobody_has_stated_is_an_alternative(tmp_path: Path) -> None:
    silent = {"sigma_focal_px": None, "sigma_center_px": None}
    for camera, is_tried in ((silent, True), ({}, False)):
        plan = PlannedFringes(load_fringes_plan(planned(tmp_path / "p", camera=camera)))
        tried = {one.key: one for one in plan.changes() if one.is_worth_a_look({"slope_x": {"unstated setup": 0.9}})}
        assert ("camera.sigma_focal_px, camera.sigma_center_px" in tried) is is_tried
        assert any(one.states_sigma for one in tried.values()) is is_tried
    (known,) = [one for one in plan.changes() if one.key == "screen.sigma_rotation_mrad"]
    assert known.after == "0.15, 0.15, 0.15"


@pytest.mark.parametrize(("states_sigma", "words"), [(True, "2.00 times larger, as is"), (False, "2.00 times worse")])
def test_a_sigma_that_grows_because_it_is_stated_is_not_worse(*, states_sigma: bool, words: str) -> None:
    change = Change("stated", "key", "", "1", cast(PlannedSource, None), states_sigma=states_sigma)
    found = Alternative(change, {}, {"slope_x": 1.5, "mean_normal": 0.5}, {})
    said = words_of_best([found], LIMITED, lambda _: ())
    assert "slopes in x 1.50 times better" in said
    assert words in said


def test_dots_of_too_few_pixels_are_refused_with_what_to_do(tmp_path: Path) -> None:
    across, down = (one.ravel() for one in np.meshgrid(np.arange(9), np.arange(9)))
    centers = 1.5 * np.stack([across, down], axis=1)
    places = DotPlaces(np.stack([across, down], axis=1), centers, np.tile(0.2 * np.eye(2), (81, 1, 1)))
    with pytest.raises(EstimationError, match=r"dots of 0\.9 px x 0\.9 px, 1\.5 px apart.*come nearer"):
        measured_sample([places], 80.0, 1.0, 0.7, Polarity.BLACK_ON_WHITE)


def test_more_frames_and_less_noise_are_worth_what_they_are(tmp_path: Path) -> None:
    once, half = (prospect(planned(tmp_path / str(noise), plan={"noise_dn": noise})) for noise in (2.0, 1.0))
    assert half.numbers["sigma_random_x_rms_rad"] == pytest.approx(
        0.5 * float(once.numbers["sigma_random_x_rms_rad"] or 0), rel=0.03
    )


def test_bad_plans_are_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(**changes: Any) -> str:
        return plan_command(planned(tmp_path / "p", **changes), capsys)

    assert "behind the camera" in refused(plan={"mirror_m": [0.0, 0.0, -9.0]})
    assert "reaches beyond the image" in refused(plan={"mirror_m": [0.0, 0.0, 4.0]})
    assert "where the mirror will stand is not said" in refused(plan={"mirror_m": None}, mirror={"distance": None})
    away = {"rotation_vector_rad": [0.0, 0.0, 0.0], "translation_m": [0.0, 0.0, 9.0]}
    assert "behind the mirror" in refused(mirror={"pose": away, "distance": None})
    to_the_side = {
        "rotation_vector_rad": [np.pi * np.cos(0.3), 0.0, np.pi * np.sin(0.3)],
        "translation_m": [0.0, 0.0, 9.0],
    }
    assert "no part of the mirror shows the screen" in refused(mirror={"pose": to_the_side, "distance": None})
    file = planned(tmp_path / "p") / "measurement.toml"
    text = file.read_text()
    file.write_text("\n".join(one for one in text.splitlines() if not one.startswith(("design", "focal_length_m"))))
    assert "design is missing" in plan_command(file.parent, capsys)
    file.write_text(text.replace('kind = "deflectometry"', 'kind = "deflectometry-poses"'))
    assert 'kind = "deflectometry-poses" has no plan; those that have: "deflectometry", ' in plan_command(
        file.parent, capsys
    )
    file.write_text(text.replace('kind = "deflectometry"', 'kind = "deflectometri"'))
    assert 'did you mean "deflectometry"?' in plan_command(file.parent, capsys)


def test_a_tilt_that_loses_the_outline_is_no_rival_of_the_other(tmp_path: Path) -> None:
    """From here one of the two tilts in which a flat square looks alike finds no edge; the other fits to 0.02 px."""
    found = prospect(planned(tmp_path / "p", Knowledge(), plan={"mirror_m": [0.035, 0.056, 6.76]}))
    assert float(found.numbers["pose_residual_px"] or 9.0) < 0.03


@pytest.mark.slow
def test_parts_that_look_past_the_screen_are_one_doubt(tmp_path: Path) -> None:
    """Where the pose is given the rest is measured, which says the same by three other signs."""
    pose = preset_scene("small").bench.cam_from_mirror
    given = {"rotation_vector_rad": pose.rotation_vector_rad.tolist(), "translation_m": pose.translation_m.tolist()}
    found = prospect(planned(tmp_path / "p", mirror={"pose": given, "distance": None}, screen={"width_m": 1.6}))
    assert 0.5 < found.seen_share < 0.8
    assert [one.code for one in found.doubts if one.severity is not Severity.NOTE] == ["plan_sees_past_screen"]


@pytest.mark.slow
def test_a_mean_normal_without_sigmas_of_camera_and_screen_is_named(tmp_path: Path) -> None:
    """Nothing else says where the screen hangs: the sigma is that of the mirror's pose alone, some microradians."""
    silent = {"sigma_rotation_mrad": None, "sigma_translation_mm": None}
    found = prospect(planned(tmp_path / "p", Knowledge(sigma_distance_mm=1.0), screen=silent))
    (doubt,) = [one for one in found.doubts if one.code == "mean_normal_without_sigmas"]
    assert "has the pose of the screen as exact" in doubt.text
    assert "with the pose of the screen as exact" in found.texts["mean normal"]
    assert found.sigmas()["mean_normal"] < 1e-4


def test_a_surveyed_place_is_said_to_be_used_as_far_as_it_is(tmp_path: Path) -> None:
    """To a place gives way what has a sigma: the camera alone, or nothing, and then it is not used."""
    bench = preset_scene("small").bench
    place = bench.cam_from_wall.inverse().apply(bench.cam_from_mirror.translation_m).tolist()
    mirror = {"place": {"place_m": place, "sigma_mm": 2.0}, "distance": None}
    sure_camera = {"sigma_focal_px": None, "sigma_center_px": None}
    sure_screen = {"sigma_rotation_mrad": None, "sigma_translation_mm": None}
    found = [
        prospect(planned(tmp_path / "p", Knowledge(), mirror=mirror, camera=camera, screen=sure_screen))
        for camera in ({"sigma_focal_px": 3.0, "sigma_center_px": 3.0}, sure_camera)
    ]
    camera_alone, neither = (one.texts["mean normal"] for one in found)
    assert "with the pose of the screen as exact" in camera_alone
    assert "to which the camera gave way and the turn of the screen did not" in camera_alone
    assert "with the camera and the pose of the screen as exact" in neither
    assert "was not used, for want of sigmas" in neither
    assert not any("[mirror.place]" in one.texts["mean normal"] for one in found)
    assert ["place_not_used" in {doubt.code for doubt in one.doubts} for one in found] == [False, True]


@pytest.mark.slow
def test_predicted_dots_are_where_they_will_be_seen_and_less_noise_is_worth_something(tmp_path: Path) -> None:
    """Dots 0.02 px off their places are rough slopes: half of the noise made their sigmas 1.7 times as large."""
    drawn_dots().write(tmp_path / "p", 0)
    planned_dots = [
        PlannedDots(changed(load_dots_plan(tmp_path / "p"), {"plan.contrast_dn": 80.0, "plan.noise_dn": noise}))
        for noise in (1.0, 0.5)
    ]
    bench = planned_dots[0].bench
    screen = bench.setup.screen
    assert isinstance(screen, DotScreen)
    dots = places_of_dots(bench, bench.sights[0], screen, 0.01)
    seen = trace_pixels(bench.setup, bench.cam_from_mirror, bench.facets[0], dots.centers_px)
    off = [
        one * (count - 1) - place
        for one, count, place in zip(
            seen[:2],
            (screen.shape[1], screen.shape[0]),
            (dots.number[:, 0] - screen.first[0], screen.first[1] - dots.number[:, 1]),
            strict=True,
        )
    ]
    # Of 9 px between dots: a tenth of the noise, 0.017 px, at most.
    assert np.abs(off).max() < 2e-4
    once, half = (one.prospect() for one in planned_dots)
    for axis in "xy":
        key = f"sigma_random_{axis}_rms_rad"
        assert float(half.numbers[key] or 9.0) < 0.9 * float(once.numbers[key] or 0.0)


@pytest.mark.slow
def test_facets_that_may_stand_beside_their_places_limit_the_canting(tmp_path: Path) -> None:
    """Along the line of sight, where it counts; with half of the sigma canting is known twice as well."""
    scene = ensemble_scene(columns=2, rows=1)
    sigmas = []
    for sigma_mm in (2.0, 1.0):
        known = Knowledge(sigma_facet_mm=(0.1, 0.1, sigma_mm))
        names = ["later.png"] * scene.pattern.n_frames
        content = measurement_content(scene, names, known, np.random.default_rng(0))
        content["plan"] = {"mirror_m": scene.bench.cam_from_mirror.translation_m.tolist()}
        folder = tmp_path / f"{sigma_mm}"
        folder.mkdir()
        write_measurement(folder, content, comment="A plan.")
        found = prospect(folder)
        sigmas.append(found.sigmas()["canting"])
        assert found.limits()["canting"]["place of a facet"] > 0.9
    assert sigmas[0] == pytest.approx(2 * sigmas[1], rel=0.1)


@pytest.mark.slow
def test_alternatives_by_the_command(tmp_path: Path) -> None:
    """A screen whose turn limits everything: knowing it twice as well is worth nearly twice the mean normal."""
    known = Knowledge(sigma_distance_mm=1.0, sigma_screen_rotation_mrad=1.0)
    folder, out = planned(tmp_path / "p", known), tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(folder), "-o", str(out), "-q"])
    assert ended.value.code == 0
    table = read_table_csv(out / ALTERNATIVES_FILE, ("change", "gain_mean_normal", "key"))
    gains = dict(zip(table["key"], table["gain_mean_normal"], strict=True))
    assert float(gains["screen.sigma_rotation_mrad"]) == pytest.approx(2.0, rel=0.05)
    assert float(gains["mirror.place"]) > 3.0
    assert float(gains["pattern.set.steps_deg"]) == pytest.approx(1.0, abs=0.02)
    # Nothing of the camera was uncertain: no alternative asks for more of it.
    assert not any(key.startswith("camera") for key in table["key"])
    assert "screen pose" in read_table_csv(out / LIMITS_FILE, ("source",))["source"]
    assert read_slope_map(out / MAP_FILE).valid.any()
    page = (out / "report.html").read_text()
    assert "What would better it" in page
    assert "turn known twice as well" in page


@pytest.mark.slow
def test_errors_of_drawn_fringes_are_as_large_together_as_promised(tmp_path: Path) -> None:
    """Six seeds of four numbers: the root of chi-square over 24 is 1 +- 0.14; the benchmark takes more."""
    drawn = drawn_fringes()
    drawn.write(tmp_path / "planned", 99)
    promise = drawn.promise(tmp_path / "planned")
    found = list(outcomes(drawn, tmp_path, 6))
    assert 0.7 < joint_ratio([one.errors for one in found], promised_covariance(promise)) < 1.35
    for name, sigma in promise.sigmas().items():
        assert sigma == pytest.approx(np.mean([one.stated[name] for one in found]), rel=0.15), name


@pytest.mark.slow
@pytest.mark.parametrize("source", [drawn_dots, drawn_tower])
def test_what_is_promised_is_what_is_then_stated(tmp_path: Path, source: Any) -> None:
    drawn = source()
    drawn.write(tmp_path / "planned", 99)
    promise = drawn.promise(tmp_path / "planned")
    (found,) = outcomes(drawn, tmp_path, 1)
    for name, sigma in promise.sigmas().items():
        assert sigma == pytest.approx(found.stated[name], rel=0.3), name
