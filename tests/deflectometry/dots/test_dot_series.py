"""Photos of marked dots in a mirror that moves: a row for each, turns within their sigmas, faults named."""

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest

from data_synth.dots import DotScene, write_dot_series
from data_synth.fringes.presets import FULL_CAMERA, facet_scene, rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet
from data_synth.optics.surface_errors import Dimple, EdgeTurnDown, Polynomial, Ripple, SurfaceErrors, Zernike
from deflectometry.dots.series.first_shape import FirstShape
from deflectometry.dots.series.frame_slopes import FacetMotion, FrameSlopes, facet_motion
from deflectometry.dots.series.keys import load_series
from deflectometry.dots.series.motion import Motion
from deflectometry.dots.series.pipeline.measure import run
from deflectometry.dots.series.pipeline.result import FrameRow, sigma_of_rms
from deflectometry.dots.series.turn_shares import turn_shares
from deflectometry.pipeline.source_slopes import SolvedSource
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import RectangularScreen, Setup
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import sigma_of_tilt, tilt_of
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, plane
from heliogauge.measurement.writer import write_measurement
from heliogauge.validate import BoolArray, FloatArray

#: Turns about x and y [rad]; the fourth frame jumps by more than half of a dot's distance.
TURNS = 1e-3 * np.array([[0.0, 0.0], [0.15, -0.1], [0.35, -0.15], [3.0, 2.1], [2.9, 2.3], [0.4, 0.3]])


def test_a_steady_turn_is_predicted_and_a_jump_makes_the_next_less_sure():
    motion = Motion(3e-3)
    poses = [RigidTransform.from_rotation_vector([1e-3 * k, 0.0, 0.0], [0.0, 0.0, 9.0]) for k in range(8)]
    misses = [motion.add(float(k), pose) for k, pose in enumerate(poses)]
    assert misses[1] == pytest.approx(1e-3, rel=1e-3)
    assert max(misses[2:]) < 1e-9
    calm = motion.sigma_rad
    motion.lose()
    assert motion.sigma_rad == pytest.approx(2.0 * calm)
    assert motion.add(8.0, RigidTransform.from_rotation_vector([0.02, 0.0, 0.0], [0.0, 0.0, 9.0])) > 0.01
    assert motion.sigma_rad > 2.0 * calm


def drawn_mirror(rng: np.random.Generator, side_m: float) -> SurfaceErrors:
    """Return a mirror with astigmatism, coma, a ripple, a dimple and turned-down edges of any size."""
    size = side_m * np.sqrt(2.0)
    bend = [(2, 0, 6e-4 / size), (0, 2, 4e-4 / size), (1, 1, 5e-4 / size)]
    return SurfaceErrors(
        (
            Polynomial([(i, j, value * rng.normal()) for i, j, value in bend]),
            Zernike(3, 1, 4e-5 * size * rng.normal(), 0.5 * size),
            Ripple(2e-4 * rng.normal(), rng.uniform(0.12, 0.5), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)),
            Dimple(-3e-5 * size * rng.normal(), 0.09 * size, *rng.uniform(-0.3, 0.3, 2)),
            EdgeTurnDown(4e-4 * abs(rng.normal()), 0.05 * size, 0.5 * side_m, 0.5 * side_m),
        )
    )


def lattice_motion(
    errors: SurfaceErrors, facet: Facet, places_m: FloatArray, seen: BoolArray, noise: float, rng: np.random.Generator
) -> FacetMotion:
    """Return what a frame tells of a mirror that shows dots at these places, (2, h, w), where it shows them."""
    x, y = places_m
    _, *true = errors.evaluate(x, y)
    slopes = np.where(seen, np.stack(true) + noise * rng.normal(size=(2, *x.shape)), np.nan)
    sigma = np.full(x.shape, noise, dtype=np.float32)
    image = SlopeImage(0, 0, x, y, *slopes, sigma, sigma, np.zeros(x.shape, dtype=np.uint32))
    return facet_motion(facet, RigidTransform.identity(), image, np.zeros(2))


@pytest.mark.parametrize("oblique_rad", [0.0, 0.03])
def test_turns_and_rms_scatter_as_their_sigmas_say_when_dots_cross_the_edges(oblique_rad: float) -> None:
    """Dots on 80 mirrors before a pattern that moves by 0.1 to 3 of its spacing.

    How far an edge is from its next line is not known, nor in which of the frames one is: sigmas of the RMS are upper
    bounds.
    """
    rng, side_m, noise = np.random.default_rng(4), 1.2, 1.5e-6
    facet = Facet("f", rectangle(side_m, side_m), plane())
    turns, squares = [], []
    for _ in range(80):
        errors, spacing_m = drawn_mirror(rng, side_m), rng.uniform(0.04, 0.08)
        number = np.arange(-int(side_m / spacing_m) - 3, int(side_m / spacing_m) + 4)
        phase, reach_m = rng.uniform(0, 1, 2), 0.5 * side_m - 0.3 * spacing_m
        moved, angle = rng.choice([0.1, 0.3, 0.6, 1.5, 3.3]), rng.uniform(0, 2 * np.pi)
        found: list[FacetMotion] = []
        for by in (0.0, moved):
            across, down = np.meshgrid(*(number + phase[:, None] + by * np.array([[np.cos(angle)], [np.sin(angle)]])))
            turned = spacing_m * np.exp(1j * oblique_rad) * (across + 1j * down)
            x, y = turned.real, turned.imag
            seen = (np.abs(x) < reach_m) & (np.abs(y) < reach_m)
            found.append(lattice_motion(errors, facet, np.stack([x, y]), seen, noise, rng))
        before, after = found
        turn, sigma = FirstShape.of(before).turn_to(after)
        turns.append(turn / sigma)
        change = np.sqrt(after.mean_squares_rad2) - np.sqrt(before.mean_squares_rad2)
        squares.append(change / sigma_of_rms(after, before, float(moved)))
    assert 0.5 < np.sqrt(np.mean(np.square(turns))) < 1.25
    assert 0.5 < np.sqrt(np.mean(np.square(squares))) < 1.25


@pytest.mark.parametrize(("first_m", "later_m"), [((-0.6, 0.0), (-0.24, 0.6)), ((-0.36, 0.0), (-0.6, 0.6))])
def test_turns_scatter_as_their_sigmas_say_when_the_frames_share_a_part_of_the_mirror(
    first_m: tuple[float, float], later_m: tuple[float, float]
) -> None:
    """Strips of 30 mirrors in the first frame and the later one: dots beyond the common part tell nothing."""
    rng, side_m, noise = np.random.default_rng(6), 1.2, 1.5e-6
    facet, ratios = Facet("f", rectangle(side_m, side_m), plane()), []
    for _ in range(30):
        errors, spacing_m = drawn_mirror(rng, side_m), rng.uniform(0.04, 0.06)
        number, found = np.arange(-20, 21), []
        for left_m, right_m in (first_m, later_m):
            places = np.stack(np.meshgrid(*spacing_m * (number + rng.uniform(0, 1, (2, 1)))))
            seen = (np.abs(places) < 0.58).all(axis=0) & (places[0] > left_m) & (places[0] < right_m)
            found.append(lattice_motion(errors, facet, places, seen, noise, rng))
        turn, sigma = FirstShape.of(found[0]).turn_to(found[1])
        ratios.append(turn / sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.15


def _seen_between(left_m: float, right_m: float, down_m: float, facet: str) -> FacetMotion:
    """Return a flat facet of 1 m that shows dots between these x, and down to this y beneath the middle."""
    places = np.stack(np.meshgrid(*np.tile(0.05 * (np.arange(20) - 9.5), (2, 1))))
    seen = (places[0] > left_m) & (places[0] < right_m) & (np.abs(places[1]) < down_m)
    flat = SurfaceErrors((Polynomial([(2, 0, 1e-4)]),))
    return lattice_motion(
        flat, Facet(facet, rectangle(1.0, 1.0), plane()), places, seen, 1e-6, np.random.default_rng(7)
    )


def test_a_facet_with_too_few_common_dots_is_left_out_with_its_reason_and_the_others_stay() -> None:
    def frame(**facets: FacetMotion) -> FrameSlopes:
        return FrameSlopes(RigidTransform.identity(), np.zeros(2), facets, 1.0, 3e-3, np.zeros((1, 2, 2)))

    start = frame(a=_seen_between(-0.5, 0.5, 0.5, "a"), b=_seen_between(-0.5, -0.1, 0.5, "b"))
    shapes = {name: FirstShape.of(one) for name, one in start.facets.items()}
    later = frame(a=_seen_between(-0.5, 0.5, 0.5, "a"), b=_seen_between(-0.15, 0.5, 0.5, "b"))
    row = FrameRow.missing("1.png", 0.1, "", ["a", "b"]).measured(later, start, shapes)
    assert row.facets["a"].count == row.count == 400
    assert not row.facets["a"].flag
    assert np.isfinite(row.turn_rad).all()
    assert np.isnan(row.facets["b"].tilt_rad).all()
    assert row.facets["b"].flag.startswith("not measured: 20 of 260 dots of facet 'b' stand where the first frame has")
    with pytest.raises(EstimationError, match="20 of 260 dots of facet 'b'"):
        FrameRow.missing("2.png", 0.2, "", ["b"]).measured(frame(b=later.facets["b"]), start, shapes)


def test_two_rows_of_dots_do_not_say_what_lies_between_them() -> None:
    number = 0.03 * (np.arange(31) - 15)
    places = np.stack(np.meshgrid(number, 0.03 * np.array([-0.5, 0.5])))
    errors, facet = SurfaceErrors((Ripple(2e-4, 0.06, 0.0, 0.0),)), Facet("f", rectangle(1.0, 1.0), plane())
    motion = lattice_motion(errors, facet, places, np.ones(places[0].shape, np.bool_), 1e-6, np.random.default_rng(8))
    with pytest.raises(EstimationError, match="in three rows and columns"):
        FirstShape.of(motion)


def test_places_on_one_line_do_not_tell_a_tilt_from_a_bend() -> None:
    facet, rng = Facet("f", rectangle(1.0, 1.0), plane()), np.random.default_rng(9)
    places = rng.uniform(-0.5, 0.5, (2, 50))
    noise = 1e-6 * rng.normal(size=(200, 2, 50))
    sigma = sigma_of_tilt(facet, places, np.full(places.shape, 1e-6))
    found = np.std([tilt_of(facet, places, one) for one in noise], axis=0)
    # The biweight is 95 % efficient; 200 drawn ones tell a deviation to 5 %.
    assert found == pytest.approx(sigma / np.sqrt(0.95), rel=0.2)
    places[0] = 0.2
    with pytest.raises(EstimationError, match="on one line"):
        sigma_of_tilt(facet, places, np.full(places.shape, 1e-6))


def test_changes_of_the_rms_scatter_by_the_noise_of_both_frames() -> None:
    """A pattern that stays: 800 changes, the RMS over their sigmas is 1 +- 0.025; with one noise alone it were 1.41."""
    rng, count, noise = np.random.default_rng(5), 64, 1e-4
    true, none, facet = 1e-3 * rng.normal(size=(2, count)), np.zeros(2), Facet("f", rectangle(1.0, 1.0), plane())
    dots = np.zeros((count, 2), dtype=np.intp)

    def seen() -> FacetMotion:
        slopes = true + noise * rng.normal(size=true.shape)
        squares = np.mean(slopes**2, axis=1)
        pose = RigidTransform.identity()
        return FacetMotion(facet, pose, none, dots, slopes, slopes, squares, none, np.full(2, noise))

    ratios = []
    for before, after in ((seen(), seen()) for _ in range(400)):
        change = np.sqrt(after.mean_squares_rad2) - np.sqrt(before.mean_squares_rad2)
        ratios.append(change / sigma_of_rms(after, before, 0.0))
    assert 0.9 < np.sqrt(np.mean(np.square(ratios))) < 1.1


@pytest.mark.parametrize(
    ("sigma", "share"),
    [
        # Further away by 1 %, what is seen moves 1 % more for the same turn; a roll turns its direction.
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.05], [[-0.01, 0.0], [0.0, -0.01]]),
        ([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0], [[0.0, -1e-3], [1e-3, 0.0]]),
        # The mirror is turned to where it is seen to look: its outline's tilt has no part.
        ([0.0, 0.01, 0.0, 0.0, 0.0, 0.0], [[0.0, 0.0], [0.0, 0.0]]),
    ],
)
def test_an_error_of_the_set_up_scales_and_rotates_a_turn(sigma: list[float], share: list[list[float]]) -> None:
    camera = Camera(100, 80, 100.0, 100.0, 50.0, 40.0)
    setup = Setup(camera, RectangularScreen(2.0, 2.0), RigidTransform.identity())
    pose = RigidTransform.from_rotation_vector([np.pi, 0.0, 0.0], [0.0, 0.0, 5.0])
    usable = SimpleNamespace(samples=[SimpleNamespace(facet=Facet("f", rectangle(1.0, 1.0), plane()))])
    seen, solution = SimpleNamespace(u=np.array([0.5]), v=np.array([0.5])), SimpleNamespace(cam_from_mirror=pose)
    slopes = cast(SolvedSource, SimpleNamespace(usable=usable, screen_map=seen, solution=solution))
    found = turn_shares(setup, UncertainPose(pose, np.diag(np.square(sigma))), slopes)
    (largest,) = (one for one in found if np.abs(one).max() == np.abs(found).max())
    sign = 1.0 if share[1][0] * largest[1, 0] >= 0.0 else -1.0
    assert sign * largest == pytest.approx(np.array(share), abs=2e-4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return six frames of a facet that shows 16 x 16 dots, the last but one dark."""
    design = Design("paraboloid", {"focal_length_m": 60.0})
    facet = SyntheticFacet("facet", rectangle(0.5, 0.5), design, standard_errors(0.5, 0.5))
    scene = DotScene(facet_scene("facet", (facet,), camera=FULL_CAMERA.scaled(0.5)), told_by="marked")
    folder = tmp_path_factory.mktemp("series") / "in"
    write_dot_series(folder, scene, TURNS, 10.0)
    dark = folder / "frame_0004.png"
    cv2.imwrite(str(dark), cv2.imread(str(dark), cv2.IMREAD_UNCHANGED) // 20)
    return folder


@pytest.mark.slow
def test_each_frame_has_its_turn_or_a_reason(folder: Path, tmp_path: Path) -> None:
    result = run(load_series(folder))
    result.write(tmp_path)
    with (tmp_path / "series.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [float(one["time_s"]) for one in rows] == pytest.approx(np.arange(6) / 10.0)
    assert rows[4]["flag"].startswith("not measured")
    assert not rows[4]["turn_x_rad"]
    assert {one.code for one in result.doubts} >= {"frames_not_measured"}
    # A turn about y by a lowers dz/dx by a; one about x raises dz/dy.
    truth: FloatArray = np.stack([-np.tan(TURNS[:, 1]), np.tan(TURNS[:, 0])], axis=1)
    good = [0, 1, 2, 3, 5]
    found = np.array([result.rows[k].turn_rad for k in good])
    sigma = np.array([result.rows[k].sigma_turn_rad for k in good])
    # Four turns in two directions: beyond four sigmas once in two thousand.
    assert (np.abs(found - truth[good])[1:] < 4.0 * sigma[1:]).all()
    assert sigma.max() < 0.02e-3
    assert min(result.rows[k].probability for k in good) > 0.999


def _changed(folder: Path, out: Path, frames: dict[str, object]) -> Path:
    out.mkdir()
    for one in (*folder.glob("*.png"), folder / "dots.csv"):
        (out / one.name).write_bytes(one.read_bytes())
    content = load_series(folder).model.model_dump(mode="json", exclude_unset=True)
    write_measurement(out, content | {"frames": frames}, comment="changed")
    return out


@pytest.mark.slow
def test_one_frame_and_times_that_are_not_there_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="1 frame is no series"):
        run(load_series(_changed(folder, tmp_path / "one", {"photos": ["frame_0000.png"]})))
    wrong = _changed(folder, tmp_path / "times", {"photos": "frame_*.png", "times_file": "times.csv"})
    (wrong / "times.csv").write_text("image,time_s\nframe_0000.png,0.0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"no time of 'frame_0001.png'"):
        run(load_series(wrong))


@pytest.mark.slow
def test_a_video_gives_what_its_frames_give(folder: Path, tmp_path: Path) -> None:
    video = tmp_path / "mirror.avi"
    frames = [cv2.imread(str(folder / f"frame_{number:04}.png")) for number in range(3)]
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"FFV1"), 10.0, (width, height))
    for one in frames:
        writer.write(one)
    writer.release()
    changed = _changed(folder, tmp_path / "video", {"video": "mirror.avi"})
    video.rename(changed / video.name)
    rows = run(load_series(changed)).rows
    assert [one.frame for one in rows] == [f"mirror.avi#{number:05}" for number in range(3)]
    assert [one.time_s for one in rows] == pytest.approx([0.0, 0.1, 0.2])
    truth = np.stack([-np.tan(TURNS[:3, 1]), np.tan(TURNS[:3, 0])], axis=1)
    for row, true in zip(rows[1:], truth[1:], strict=True):
        assert (np.abs(row.turn_rad - true) < 4.0 * row.sigma_turn_rad).all()
