"""Which photos of a board are believed: by what the others predict for them; and sets that determine no camera."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.camera.adjustment.board_adjustment import Adjusted, AsDrawn
from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment
from calibration.camera.adjustment.other_photos import Known, PhotoFit
from calibration.camera.boards import Chessboard, CircleGrid
from calibration.camera.corners.detection import BoardPoints, FoundBoards
from calibration.camera.judgement.network import alike_text, check_predictions
from calibration.camera.pipeline import solving
from calibration.camera.pipeline.photos import left_out_doubts
from calibration.camera.pipeline.solving import Solved, solve_network
from calibration.camera.start_values.board_network import BoardNetwork
from calibration.camera.start_values.first_network import first_network
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.running.progress import SilentProgress
from heliogauge.validate import FloatArray
from photogrammetry.centers import eccentricity_px

FREE = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3")
BOARD = Chessboard(9, 6, 0.03)
#: Large dots: the centre of an image is 0.1 px off the image of the centre. The first does not look the same turned,
#: the second looks the same in a mirror.
SHIFTED_CIRCLES = CircleGrid(6, 9, asymmetric=True, pitch_known_m=0.03, diameter_share=0.65)
CIRCLES = CircleGrid(9, 6, pitch_known_m=0.03, diameter_share=0.8)
CAMERA = Camera(960, 720, 900.0, 900.0, 470.0, 365.0, 0.0, BrownDistortion(k1=-0.1, k2=0.05, p1=1e-4, p2=-2e-4))
NOISE_PX = 0.05


def bent_board(rng: np.random.Generator, board: Chessboard | CircleGrid = BOARD) -> FloatArray:
    """A print bent by a millimetre and sheared by 0.3 mrad."""
    places = board.points_m.copy()
    x, y = (places[:, :2] / np.abs(places[:, :2]).max(axis=0)).T
    places[:, 2] += 1e-3 * (rng.normal(0, 0.7) * x * x + rng.normal(0, 0.5) * y * y + rng.normal(0, 0.5) * x * y)
    places[:, :2] += 3e-4 * places[:, :2] @ np.triu(rng.normal(0, 1, (2, 2)))
    return places


def seen(
    name: str,
    places: FloatArray,
    tilt: FloatArray,
    rng: np.random.Generator,
    roll: float = 0.0,
    mirrored: bool = False,
    board: Chessboard | CircleGrid = BOARD,
) -> BoardPoints:
    """A photo of the board turned by rotation vector ``tilt`` out of the image's plane, perhaps of a mirrored file."""
    turn = rotation_from_vector(np.array([0, 0, roll])) @ rotation_from_vector(tilt) @ np.diag([1.0, -1.0, -1.0])
    shift = np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.38, 0.55)])
    pose = RigidTransform(turn, shift)
    pixels = CAMERA.project(pose.apply(places)) + rng.normal(0, NOISE_PX, (len(places), 2))
    if isinstance(board, CircleGrid):
        normals = np.tile(pose.rotate(np.array([0.0, 0.0, 1.0])), (len(places), 1))
        pixels = pixels + eccentricity_px(
            CAMERA, pose.apply(places), normals, 0.5 * board.diameter_share * board.pitch_m
        )
    if mirrored:
        # The detector numbers what it sees as a board seen from the front.
        pixels = (pixels * [-1.0, 1.0] + [CAMERA.width_px - 1, 0.0]).reshape(board.rows, board.columns, 2)[:, ::-1]
    covariance = np.tile(NOISE_PX**2 * np.eye(2), (len(places), 1, 1))
    return BoardPoints(name, np.arange(len(places)), pixels.reshape(-1, 2), covariance)


def three_and_one(seed: int) -> list[BoardPoints]:
    """Three photos of one tilt and one tilted the other way: mirrored, it would look like the three."""
    rng = np.random.default_rng(seed)
    places = bent_board(rng)
    tilts = [*(rng.normal(15, 1) for _ in range(3)), rng.normal(-15, 1)]
    names = ["a.png", "b.png", "c.png", "other.png"]
    return [
        seen(name, places, np.radians([rng.normal(0, 1), tilt, 0.0]), rng, rng.normal(0, 0.05))
        for name, tilt in zip(names, tilts, strict=True)
    ]


def all_round(
    seed: int, count: int, mirrored: int | None = None, board: Chessboard | CircleGrid = BOARD
) -> list[BoardPoints]:
    """Photos from all sides, one of them perhaps mirrored."""
    rng = np.random.default_rng(seed)
    places = bent_board(rng, board)
    photos = []
    for k in range(count):
        tilt, azimuth = np.radians(rng.uniform(15, 40)), 2.4 * k
        vector = tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        photos.append(seen(f"{k}.png", places, vector, rng, 0.5 * np.pi * (k % 3), k == mirrored, board))
    return photos


def solved(photos: list[BoardPoints], board: Chessboard | CircleGrid = BOARD) -> tuple[Solved, dict[str, str]]:
    contradicting: dict[str, str] = {}
    network, _ = first_network(FoundBoards(tuple(photos), {}, (960, 720)), board, FREE, {})
    found = solve_network(network, contradicting, SilentProgress(), refine_board=True, leave_one_out=True)
    return found, contradicting


def focal_off(found: Solved) -> float:
    """Error of the focal length in its sigma."""
    camera = found.adjusted.mixed.camera
    return float(abs(camera.focal_x_px - CAMERA.focal_x_px) / camera.sigma_parameters[0])


def assert_same_camera(found: Solved, other: Solved) -> None:
    """Equal as far as the iteration goes; the correction of circles' centres ends a hundredth of a sigma off."""
    one, two = (solution.adjusted.mixed.camera for solution in (found, other))
    within = 0.01 * two.sigma_parameters if isinstance(found.network.board, CircleGrid) else 0.0
    off = np.abs(one.parameters - two.parameters)
    assert (off <= 1e-4 + 1e-4 * np.abs(two.parameters) + within).all()


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 4, 5, 12))])
def test_the_only_photo_tilted_the_other_way_is_used(seed: int) -> None:
    found, contradicting = solved(three_and_one(seed))
    assert contradicting == {}
    assert len(found.network.points) == 4
    assert focal_off(found) < 3
    names = [one.photo for one in found.network.points]
    codes = {one.code for one in check_predictions(names, found.apart_px, found.apart_expected_px)}
    assert "photos_contradict" not in codes


@pytest.mark.parametrize(
    ("count", "board"),
    [(5, BOARD), pytest.param(8, BOARD, marks=pytest.mark.slow), pytest.param(6, CIRCLES, marks=pytest.mark.slow)],
)
def test_a_mirrored_photo_is_left_out_with_a_warning(count: int, board: Chessboard | CircleGrid) -> None:
    photos = all_round(1, count, mirrored=3, board=board)
    found, contradicting = solved(photos, board)
    assert list(contradicting) == ["3.png"]
    assert "mirror image" in contradicting["3.png"]
    assert len(found.network.points) == count - 1
    assert focal_off(found) < 3
    (doubt,) = left_out_doubts(contradicting.values(), Severity.DOUBT)
    assert doubt.severity is Severity.DOUBT
    # As if it had never been there.
    others, _ = solved([one for one in photos if one.photo != "3.png"], board)
    assert_same_camera(found, others)


def test_three_photos_do_not_convict_a_fourth() -> None:
    found, contradicting = solved(all_round(1, 4, mirrored=3))
    assert contradicting == {}
    assert len(found.network.points) == 4
    names = [one.photo for one in found.network.points]
    (doubt,) = check_predictions(names, found.apart_px, found.apart_expected_px)
    assert doubt.code == "photos_contradict"
    assert "3.png" in doubt.text
    assert "mirror image" in doubt.text


@pytest.mark.slow
@pytest.mark.parametrize("board", [BOARD, SHIFTED_CIRCLES])
def test_photos_of_another_board_are_left_out_and_true_ones_come_back(
    board: Chessboard | CircleGrid, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = all_round(2, 7, board=board)
    # Four pairs of corners exchanged: each is a square off.
    mixed = np.arange(54)
    mixed[[0, 1, 16, 17, 36, 37, 52, 53]] = [1, 0, 17, 16, 37, 36, 53, 52]
    photos[2] = replace(photos[2], index=mixed)
    found, contradicting = solved(photos, board)
    assert list(contradicting) == ["2.png"]
    assert "miss the board by" in contradicting["2.png"]
    assert focal_off(found) < 3
    # As soon as the board's shape is not as drawn, a true photo may be put aside at first.
    first = solving.adjust_as_drawn

    def with_one_more_aside(network: BoardNetwork) -> AsDrawn:
        drawn = first(network)
        place = next(k for k, one in enumerate(drawn.network.points) if one.photo == "4.png")
        return drawn._replace(network=drawn.network.without(place), aside=(*drawn.aside, drawn.network.points[place]))

    monkeypatch.setattr(solving, "adjust_as_drawn", with_one_more_aside)
    again, contradicting = solved(photos, board)
    assert list(contradicting) == ["2.png"]
    assert [one.photo for one in again.network.points] == [one.photo for one in found.network.points]
    assert_same_camera(again, found)


def test_without_the_photo_on_which_all_rests_there_is_no_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    true = solving.adjust_others

    def none_without_the_other(network: object, adjusted: object, photo: int, **more: bool) -> object:
        if photo == 3:
            raise EstimationError("calibration: camera and board do not settle")
        return true(network, adjusted, photo, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(solving, "adjust_others", none_without_the_other)
    found, _ = solved(three_and_one(5))
    names = [one.photo for one in found.network.points]
    (doubt,) = check_predictions(names, found.apart_px, found.apart_expected_px)
    assert doubt.code == "photos_stand_alone"
    assert "other.png (without it the others determine no camera)" in doubt.text


def test_others_without_sizes_of_their_own_still_predict_the_photo(monkeypatch: pytest.MonkeyPatch) -> None:
    true = solving.adjust_others

    def none_of_their_own(network: BoardNetwork, adjusted: Adjusted, photo: int, **more: bool) -> MixedAdjustment:
        if more:
            raise EstimationError("calibration: camera and board do not settle")
        return true(network, adjusted, photo)

    monkeypatch.setattr(solving, "adjust_others", none_of_their_own)
    found, _ = solved(all_round(1, 4, mirrored=3))
    assert np.isfinite(found.apart_px).all()
    assert np.isfinite(found.apart_expected_px).all()


def test_a_photo_that_no_pose_explains_contradicts_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    true = solving.fit_pose

    def none_for_one(known: Known, points: BoardPoints, pose: RigidTransform) -> PhotoFit:
        if points.photo == "1.png":
            raise EstimationError("bundle: targets behind their camera")
        return true(known, points, pose)

    monkeypatch.setattr(solving, "fit_pose", none_for_one)
    found, _ = solved(all_round(1, 4))
    names = [one.photo for one in found.network.points]
    (doubt,) = check_predictions(names, found.apart_px, found.apart_expected_px)
    assert doubt.code == "photos_contradict"
    assert "1.png (no pose explains it)" in doubt.text
    assert "determine no camera" not in doubt.text


@pytest.mark.parametrize("seed", range(2))
def test_photos_alike_are_named_and_nothing_warns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    photos = [seen(f"{k}.png", BOARD.points_m, rng.normal(0, 0.004, 3), rng) for k in range(3)]
    noisy = [replace(one, pixels_px=one.pixels_px + rng.normal(0, 0.3, one.pixels_px.shape)) for one in photos]
    refusal = r"camera.* 3 of 3 photos show the board alike, not turned against each other: 0\.png, 1\.png, 2\.png"
    with pytest.raises(EstimationError, match=refusal):
        solved(noisy)


def test_only_boards_turned_against_each_other_are_not_alike() -> None:
    rng = np.random.default_rng(0)
    straight, tilted, rolled = (
        seen(name, BOARD.points_m, np.radians([tilt, 0.0, 0.0]), rng, np.radians(roll))
        for name, tilt, roll in (("s.png", 0.0, 0.0), ("t.png", 15.0, 0.0), ("r.png", 0.0, 10.0))
    )
    assert alike_text([straight, tilted, rolled]) == ""
    near = seen("n.png", BOARD.points_m, np.radians([0.5, 0.0, 0.0]), rng)
    assert "2 of 4 photos" in alike_text([straight, tilted, rolled, near])
    assert alike_text([straight, tilted, rolled, near]).endswith("s.png, n.png")
