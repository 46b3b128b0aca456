"""Rows that name a photo: the beam in it becomes the row's place, and a photo without one becomes a reason."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.beam.images.target_finder import TargetFinder
from calibration.beam.target.marks import CORNERS, mark_corner
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.observations.plant import Plant
from calibration.heliostat.observations.rows import parse_rows
from calibration.heliostat.pipeline.photo_beams import beam_frames, with_measured_beams
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site
from heliogauge.images.photos import read_channel, write_image
from heliogauge.measurement.load import parse_measurement
from tests.calibration.heliostat_folders import CONTENT, TARGET

CENTER_M = (0.8, -0.6)
PLANT = Plant((37.0, -2.0, 500.0), Site(37.0, -2.0, 0.0), {TARGET.name: TARGET})
HEADER = ("time_utc", "axis_1_rad", "axis_2_rad", "target", "image", "x_m", "y_m")


def model(**images: Any) -> Any:
    return parse_measurement(CONTENT | {"images": [{"target": TARGET.name} | images]}, Path("measurement.toml"))


def draw(file: Path, center_m: tuple[float, float] = CENTER_M, peak_dn: float = 120.0) -> None:
    """Photograph the target, 8 m x 6 m on 320 x 240 pixels from edge to edge, with a Gaussian beam."""
    x = (np.arange(320) + 0.5) / 40 - 4
    y = 3 - (np.arange(240) + 0.5) / 40
    beam = np.exp(-((x - center_m[0]) ** 2 + (y[:, None] - center_m[1]) ** 2) / (2 * 0.5**2))
    noise = np.random.default_rng(0).normal(0, 1, beam.shape)
    write_image(file, np.clip(np.rint(30 + peak_dn * beam + noise), 0, 255).astype(np.uint8))


def measured(folder: Path, *cells: tuple[str, str, str], plant: Plant = PLANT, **images: Any) -> Any:
    lines = [
        (2 + n, f"2026-06-21T1{n}:00:00Z,0.1,0.2,{target},{image},{x},") for n, (target, image, x) in enumerate(cells)
    ]
    return with_measured_beams(parse_rows(HEADER, dict(lines)), folder, plant, model(**images or {"whole": "edge"}))[0]


def test_the_beam_becomes_the_rows_place(tmp_path: Path) -> None:
    draw(tmp_path / "ü 1.png")
    rows = measured(tmp_path, (TARGET.name, "ü 1.png", ""))
    assert rows.flags == ("",)
    np.testing.assert_allclose(rows.vector("x_m", "y_m"), [CENTER_M], atol=0.02)
    sigma = rows.vector("sigma_x_mm", "sigma_y_mm")
    assert ((sigma > 0.1) & (sigma < 30)).all()


def test_corners_in_the_photo_say_where_the_target_is(tmp_path: Path) -> None:
    draw(tmp_path / "1.png")
    # The target is the left half of the photo: the same pixels mean other places.
    corners = [[-0.5, -0.5], [319.5, -0.5], [319.5, 239.5], [-0.5, 239.5]]
    rows = measured(tmp_path, (TARGET.name, "1.png", ""), corners_px=corners)
    np.testing.assert_allclose(rows.vector("x_m", "y_m"), [CENTER_M], atol=0.02)
    exact, known = (
        measured(tmp_path, (TARGET.name, "1.png", ""), corners_px=corners, corners_sigma_px=sigma_px)
        for sigma_px in (0.001, 3.0)
    )
    assert (known.vector("sigma_x_mm", "sigma_y_mm") > 1.5 * exact.vector("sigma_x_mm", "sigma_y_mm")).all()


def test_photos_without_a_beam_are_reasons(tmp_path: Path) -> None:
    draw(tmp_path / "1.png")
    draw(tmp_path / "empty.png", peak_dn=0.0)
    (tmp_path / "broken.png").write_bytes(b"none")
    rows = measured(
        tmp_path,
        (TARGET.name, "1.png", ""),
        (TARGET.name, "empty.png", ""),
        (TARGET.name, "lost.png", ""),
        (TARGET.name, "broken.png", ""),
        ("roof", "1.png", ""),
    )
    assert rows.flags == ("", "image", "image", "image", "image")
    assert "empty.png: " in rows.reasons[1]
    assert "there is no photo 'lost.png'" in rows.reasons[2]
    assert "broken.png: " in rows.reasons[3]
    assert "no [[images]] states where target 'roof' is" in rows.reasons[4]


def test_a_place_that_is_told_is_kept(tmp_path: Path) -> None:
    lines = [(2, f"2026-06-21T10:00:00Z,0.1,0.2,{TARGET.name},lost.png,1.0,2.0")]
    rows, beams = with_measured_beams(parse_rows(HEADER, dict(lines)), tmp_path, PLANT, model(whole="edge"))
    assert beams is None
    np.testing.assert_array_equal(rows.vector("x_m", "y_m"), [[1.0, 2.0]])


@pytest.mark.parametrize(
    ("images", "wanted"),
    [
        ([{"target": "roof", "whole": "edge"}], "target 'roof' is not known; there are north face"),
        ([{"target": TARGET.name, "whole": "edge"}] * 2, "described twice"),
        ([{"target": TARGET.name, "whole": "edge", "camera": "no.json"}], r"no\.json: there is no such file"),
        ([{"target": TARGET.name, "whole": "edge", "empty": "e*.png"}], r"images\.empty = 'e\*\.png': no file"),
    ],
)
def test_frames_that_cannot_be_used(tmp_path: Path, images: list[Any], wanted: str) -> None:
    found: Any = parse_measurement(CONTENT | {"images": images}, tmp_path / "measurement.toml")
    with pytest.raises(InputError, match=wanted):
        beam_frames(tmp_path, PLANT, found)


# --- marks of a real tower --------------------------------------------------------------------------------------------

#: Multi focus tower at Juelich, from mark to mark.
TOWER = PlaneTarget.facing(TARGET.name, [0.0, 0.0, 40.0], np.pi, 5.42, 6.38)


def pictures(shared_data: Path, *names: str) -> list[str]:
    return [str(shared_data / "csp" / "juelich_beam_images" / "markers" / f"{name}.png") for name in names]


def of_tower(shared_data: Path, **images: Any) -> Any:
    """Measure the beam in the one raw frame, 3072 x 1728 pixels, through marks of its target."""
    plant = Plant(PLANT.origin, PLANT.site, {TOWER.name: TOWER})
    folder = shared_data / "csp" / "juelich_beam_images"
    return measured(folder, (TOWER.name, "203718-raw.png", ""), plant=plant, **images)


@pytest.mark.slow
def test_anchors_say_which_point_of_a_mark_is_the_corner(shared_data: Path) -> None:
    """The outer corners of the marks, given by hand, put the beam where they do by themselves; others elsewhere."""
    names = ("mft_left_top", "mft_right_top", "mft_right_bottom", "mft_left_bottom")
    files = pictures(shared_data, *names)
    corners = [
        mark_corner(read_channel(Path(one), "luminance"), corner)[0] for one, corner in zip(files, CORNERS, strict=True)
    ]
    alone, same, moved = (
        of_tower(shared_data, markers=files, **given).vector("x_m", "y_m")[0]
        for given in (
            {},
            {"anchors_px": [one.round(3).tolist() for one in corners]},
            {"anchors_px": [(one + [40.0, 0.0]).round(3).tolist() for one in corners]},
        )
    )
    np.testing.assert_allclose(same, alone, atol=1e-4)
    # A target of 5.42 m lies on some 900 pixels; 40 pixels of the pictures of marks, to the right, are 0.2 m and more.
    assert moved[0] < alone[0] - 0.1


@pytest.mark.parametrize(
    ("names", "is_refused"),
    [
        (("stj_left_top", "stj_right_top", "stj_right_middle", "stj_left_middle"), True),
        (("stj_left_middle", "stj_right_middle", "stj_right_bottom", "stj_left_bottom"), True),
        (("stj_left_top", "stj_right_top", "stj_right_bottom", "stj_left_bottom"), False),
        (("mft_left_top", "mft_right_top", "mft_right_bottom", "mft_left_bottom"), False),
    ],
)
def test_shared_marks_need_anchors_and_no_others(shared_data: Path, names: tuple[str, ...], is_refused: bool) -> None:
    """Of the tower's targets those that share their middle marks are refused without anchors, and taken with them."""
    plant = Plant(PLANT.origin, PLANT.site, {TOWER.name: TOWER})
    files = pictures(shared_data, *names)
    (frame,) = beam_frames(Path(), plant, model(markers=files)).values()
    (anchored,) = beam_frames(Path(), plant, model(markers=files, anchors_px=[[75.0, 75.0]] * 4)).values()
    TargetFinder(anchored)
    if is_refused:
        with pytest.raises(InputError, match=r"middle\.png: .*T-shaped.*give anchors_px"):
            TargetFinder(frame)
    else:
        TargetFinder(frame)
