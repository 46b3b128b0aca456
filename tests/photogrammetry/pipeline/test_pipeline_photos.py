"""Targets of photos through measurement.toml's section: codes of one's own, the sense of counting, unknown codes."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.targets.isolated_target import IsolatedTarget, draw_isolated
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import write_image
from heliogauge.running.progress import SilentProgress
from heliogauge.validate import FloatArray
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.pipeline.inputs import build_search
from photogrammetry.pipeline.photos import MeasuredPhotos, collect_photos, measure_each
from photogrammetry.targets.coded_targets import aicon_dictionary
from photogrammetry.targets.ring_codes import RingRadii, Sense, mirrored_word

#: Words that are not their own mirror image and whose mirror image is not among them.
CHIRAL = [word for word in aicon_dictionary(12).words if word < mirrored_word(word, 12)][:6]


def photo(folder: Path, sense: Sense, radii: RingRadii) -> Path:
    """Six targets side by side."""
    codes = aicon_dictionary(12).as_printed(sense, radii).codes
    chosen = [code for code in codes if code.word in CHIRAL]
    drawn = [
        draw_isolated(IsolatedTarget(18.0, code=code), np.random.default_rng(k)).image_dn
        for k, code in enumerate(chosen)
    ]
    path = folder / "photo.png"
    write_image(path, np.rint(np.vstack([np.hstack(drawn[:3]), np.hstack(drawn[3:])])).clip(0, 255).astype(np.uint8))
    return path


def measured(path: Path, **keys: object) -> MeasuredPhotos:
    section = TargetsSection.model_validate(keys)
    search = build_search(section, path.parent)
    return collect_photos(measure_each([path], section, search, jobs=1, progress=SilentProgress()))


def own_list(folder: Path, *lines: str) -> None:
    (folder / "own.csv").write_text("\n".join(["# bits = 12", *lines, "word", *map(str, CHIRAL)]), encoding="utf-8")


def test_codes_of_one_s_own_are_read_by_name(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.COUNTERCLOCKWISE, RingRadii(1.8, 2.6))
    own_list(tmp_path, "# sense = counterclockwise", "# inner_radius = 1.8", "# outer_radius = 2.6")
    found = measured(path, dictionary="own.csv")
    assert sorted(found.points.targets, key=int) == [str(word) for word in CHIRAL]


def test_keys_of_the_measurement_win_over_the_list(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.COUNTERCLOCKWISE, RingRadii(1.8, 2.6))
    own_list(tmp_path)
    keys = {"sense": "counterclockwise", "ring_inner_radius": 1.8, "ring_outer_radius": 2.6}
    assert len(measured(path, dictionary="own.csv", **keys).points.targets) == 6


def test_the_wrong_sense_ends_with_the_key_to_set(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.COUNTERCLOCKWISE, RingRadii())
    own_list(tmp_path)
    with pytest.raises(EstimationError, match=r'6 of 6 code rings.*mirror images.*sense = "counterclockwise"'):
        measured(path, dictionary="own.csv")


def test_codes_of_another_list_are_told_by_their_bits(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.CLOCKWISE, RingRadii())
    (tmp_path / "own.csv").write_text("# bits = 12\nword\n1\n3\n", encoding="utf-8")
    with pytest.raises(EstimationError, match="6 code rings are not in the dictionary, bits clockwise"):
        measured(path, dictionary="own.csv")


def test_a_list_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own\.csv: there is no such file"):
        build_search(TargetsSection(dictionary="own.csv"), tmp_path)


def charuco_photo(folder: Path) -> tuple[Path, FloatArray]:
    """A board of 6 x 5 squares of 40 px, slightly turned; its inner corners, row by row."""
    table = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((6, 5), 1.0, 0.7, table)
    flat = board.generateImage((6 * 160, 5 * 160), marginSize=0)
    flat = cv2.copyMakeBorder(flat, 160, 160, 160, 160, cv2.BORDER_CONSTANT, value=255)
    turn = np.array([[0.985, -0.12, 90.0], [0.11, 0.97, 60.0], [2e-5, 1e-5, 1.0]])
    large = cv2.warpPerspective(flat, turn, (1440, 1360), flags=cv2.INTER_AREA, borderValue=255)
    image = cv2.GaussianBlur(large, (0, 0), 2.0).reshape(340, 4, 360, 4).mean(axis=(1, 3)) * 0.7 + 30
    image += np.random.default_rng(0).normal(0, 1, image.shape)
    x, y = np.meshgrid(np.arange(1, 6) * 160 + 159.5, np.arange(1, 5) * 160 + 159.5)
    corners = cv2.perspectiveTransform(np.stack([x, y], axis=-1).reshape(1, -1, 2), turn)[0]
    path = folder / "board.png"
    write_image(path, np.rint(image).clip(0, 255).astype(np.uint8))
    return path, (corners + 0.5) / 4 - 0.5


def test_charuco_boards_give_markers_and_inner_corners(tmp_path: Path) -> None:
    path, corners = charuco_photo(tmp_path)
    board = {"columns": 6, "rows": 5, "square_mm": 40.0, "marker_mm": 28.0}
    found = measured(path, dictionary="DICT_4X4_50", charuco=board).points
    places = dict(zip(found.targets, found.pixels_px[np.argsort(found.target_index)], strict=True))
    assert sum("board." not in name for name in places) == 4 * 15
    for number, corner in enumerate(corners):
        assert places[f"board.{number}"] == pytest.approx(corner, abs=0.05)


def test_a_charuco_board_needs_its_markers_dictionary() -> None:
    board = {"columns": 6, "rows": 5, "square_mm": 40.0, "marker_mm": 28.0}
    with pytest.raises(ValueError, match="that of the board's markers"):
        TargetsSection.model_validate({"dictionary": "aicon-12", "charuco": board})


def test_a_photo_without_targets_is_named(tmp_path: Path) -> None:
    first = photo(tmp_path, Sense.CLOCKWISE, RingRadii())
    blank = tmp_path / "blank.png"
    write_image(blank, np.full((300, 400), 128, dtype=np.uint8))
    section = TargetsSection.model_validate({"dictionary": "aicon-12"})
    search = build_search(section, tmp_path)
    found = collect_photos(measure_each([first, blank], section, search, jobs=1, progress=SilentProgress()))
    (doubt,) = (one for one in found.doubts if one.code == "photos_without_target")
    assert doubt.text == "1 of 2 photos show no target that can be used: blank.png"
