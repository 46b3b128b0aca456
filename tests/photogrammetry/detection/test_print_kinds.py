"""Ring codes as people print them: other radii, holes, crosses, halos, a display's pixels; and what looks like one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.targets import image_truth, render_photo, target_scene, wall_scenes
from data_synth.targets.code_wall import WallOfCodes
from data_synth.targets.isolated_target import IsolatedTarget, draw_isolated
from data_synth.targets.presets import PrintChoice
from data_synth.targets.scene import Conditions, ScreenPixels, Sharpening
from heliogauge.images.photos import read_image
from photogrammetry.detection.photo_targets import TargetSearch, measure_targets
from photogrammetry.targets.coded_targets import aicon_dictionary, user_dictionary
from photogrammetry.targets.ring_codes import RingCode, RingRadii, ink_at

CODES = aicon_dictionary(12)
#: Each kind of print with what makes it hard; sizes from 9 px: 16 codes are drawn in half a second.
KINDS = {
    "far ring, hole": (PrintChoice(radii=RingRadii(2.25, 3.48), hole_radii=0.3), Conditions(blur_sigma_px=0.7)),
    "near ring, cross": (PrintChoice(radii=RingRadii(1.9, 3.1), cross_radii=0.5), Conditions()),
    "large hole, halo": (
        PrintChoice(hole_radii=0.45),
        Conditions(blur_sigma_px=0.9, sharpening=Sharpening(1.5, 1.5)),
    ),
    "display, light on dark": (
        PrintChoice(light_on_dark=True),
        Conditions(blur_sigma_px=0.6, screen=ScreenPixels(3.3, 0.3)),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_prints_are_read_wherever_their_rings_lie(kind: str) -> None:
    prints, conditions = KINDS[kind]
    rng = np.random.default_rng(5)
    codes = [CODES.codes[k] for k in rng.permutation(len(CODES))[:16]]
    wall = WallOfCodes((9.0, 13.4), 0.6, prints, conditions)
    (scene,) = wall_scenes(codes, wall, rng)
    view = scene.views[0]
    truth = image_truth(scene, view)
    found = measure_targets(render_photo(scene, view, rng), "wall", TargetSearch(CODES, with_uncoded=False))
    assert sorted(found.detections.names) == sorted(truth.names)
    places = dict(zip(truth.names, truth.pixels_px, strict=True))
    off = [pixel - places[name] for name, pixel in zip(found.detections.names, found.detections.pixels_px, strict=True)]
    assert np.abs(off).max() < 0.1
    stated = prints.radii or CODES.radii
    assert found.radii[0].inner == pytest.approx(stated.inner, rel=0.06)
    assert found.radii[0].outer == pytest.approx(stated.outer, rel=0.06)


@pytest.fixture(scope="module")
def panel():
    scene = target_scene("small", 1)
    view = scene.views[0]
    image = render_photo(scene, view, np.random.default_rng(1))
    truth = image_truth(scene, view)
    return image, dict(zip(truth.names, truth.pixels_px, strict=True))


def _with_copy(image, place_px, factor):
    """Paste what is round a target into the corner of the photo, enlarged."""
    x, y = np.rint(place_px).astype(int)
    patch = image[y - 30 : y + 31, x - 30 : x + 31]
    copy = cv2.resize(patch, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    changed = image.copy()
    changed[20 : 20 + copy.shape[0], 20 : 20 + copy.shape[1]] = copy
    return changed


def test_a_logo_that_reads_like_a_code_is_refused_by_name(panel) -> None:
    image, places = panel
    found = measure_targets(_with_copy(image, places["20"], 3), "a", TargetSearch(CODES, with_uncoded=False))
    assert len(found.detections) == 40
    assert found.duplicated == ()
    where = found.detections.pixels_px[found.detections.names.index("20")]
    assert np.hypot(*(where - places["20"])) < 0.1
    (logo,) = found.unused
    assert logo.name == "20"
    assert "times the size of its neighbours'" in logo.reason


def test_two_equal_sheets_are_not_told_apart(panel) -> None:
    image, places = panel
    found = measure_targets(_with_copy(image, places["20"], 1), "a", TargetSearch(CODES, with_uncoded=False))
    assert found.duplicated == ("20",)


@pytest.mark.slow
def test_neighbours_in_a_grid_of_dots_are_no_code_rings(shared_data: Path) -> None:
    # A display with a grid of dots, no codes: around each dot its eight neighbours make a ring of 20 sectors.
    image = read_image(shared_data / "opencsp/screen_dots/DSC03996.JPG")
    found = measure_targets(image, "display", TargetSearch(CODES, with_uncoded=False))
    assert found.fitting_bits is None
    assert len(found.detections) == 0


def test_rings_of_a_real_sheet_are_found_and_their_division_is_said(shared_data: Path) -> None:
    # A sheet of another program: four codes of eight sectors, its rings at 2.55 to 4.35 radii of the dots.
    image = read_image(shared_data / "photogrammetry/dbat_camcal/images/P8250021.JPG")
    found = measure_targets(image, "sheet", TargetSearch(CODES, with_uncoded=False))
    assert found.fitting_bits == 8
    assert len(found.detections) == 0
    own = measure_targets(image, "sheet", TargetSearch(aicon_dictionary(8), with_uncoded=False))
    assert own.fitting_bits is None
    assert len(own.detections) + len(own.unknown_words) + len(own.mirrored) == 4
    assert own.radii[0].inner == pytest.approx(2.55, abs=0.08)
    assert own.radii[0].outer == pytest.approx(4.35, abs=0.1)


def test_stated_radii_hold(panel) -> None:
    image, _ = panel
    elsewhere = TargetSearch(CODES, with_uncoded=False, radii=RingRadii(2.6, 4.4))
    assert len(measure_targets(image, "a", elsewhere).detections) == 0
    stated = replace(elsewhere, radii=RingRadii(2.0, 3.0))
    assert len(measure_targets(image, "a", stated).detections) == 40


@pytest.mark.parametrize(("share", "names"), [(0.9, ("52",)), (0.6, ())])
def test_a_ring_much_paler_than_its_dot_is_no_print(share: float, names: tuple[str, ...]) -> None:
    one = draw_isolated(IsolatedTarget(16.0, code=CODES.code("52")), np.random.default_rng(0))
    y, x = np.indices(one.image_dn.shape)
    beyond = np.hypot(x - one.center_px[0], y - one.center_px[1]) > 1.5 * 8
    paper = np.median(one.image_dn)
    paled = np.where(beyond, paper + share * (one.image_dn - paper), one.image_dn)
    image = np.rint(np.clip(paled, 0, 255)).astype(np.uint8)
    assert measure_targets(image, "a", TargetSearch(CODES, with_uncoded=False)).detections.names == names


@pytest.mark.parametrize("side_radii", [4.0, 4.4, 4.8])
def test_a_dot_on_a_small_square_of_paper_is_no_code(side_radii: float) -> None:
    # The ground beyond the paper's sides makes four sectors half as dark as the dot: code 143 of the dictionary.
    fine, radius = 8, 5.3 * 8
    image = np.full((64 * fine, 64 * fine), 140, dtype=np.uint8)
    middle, half = 32.3 * fine, side_radii * radius / 2
    corners = cv2.boxPoints(((middle, middle), (2 * half, 2 * half), 11.0))
    cv2.fillPoly(image, [np.rint(corners).astype(np.int32)], 230)
    cv2.circle(image, (round(middle), round(middle)), round(radius), 40, -1)
    seen = cv2.GaussianBlur(cv2.resize(image, (64, 64), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    assert measure_targets(seen, "a", TargetSearch(CODES)).detections.names == ("u0",)


def drawn_rings(codes: Sequence[RingCode]) -> np.ndarray:
    """Six codes in two rows, dots of 80 px."""
    image = np.full((560, 840), 200.0)
    y, x = np.mgrid[:560, :840].astype(float)
    for k, code in enumerate(codes):
        dx, dy = x - (140 + 280 * (k % 3)), y - (140 + 280 * (k // 3))
        image[ink_at(code, dx / 40.0, -dy / 40.0)] = 30.0
    photo = cv2.GaussianBlur(image, (0, 0), 0.8) + np.random.default_rng(0).normal(0, 1, image.shape)
    return np.round(photo).astype(np.uint8)


@pytest.mark.parametrize("bits", [12, 16])
def test_rings_of_eight_sectors_are_not_read_as_sixteen(bits: int) -> None:
    """Each sector is two of sixteen: words of the dictionary, but of other codes."""
    photo = drawn_rings(aicon_dictionary(8).codes[:6])
    found = measure_targets(photo, "a", TargetSearch(aicon_dictionary(bits), with_uncoded=False))
    assert found.fitting_bits == 8
    assert len(found.detections) == 0


def test_a_list_of_paired_sectors_is_read_as_it_is_stated() -> None:
    eights = aicon_dictionary(8).codes[:6]
    words = [int("".join(2 * ("1" if one else "0") for one in code.sectors), 2) for code in eights]
    own = user_dictionary("own", 16, words)
    found = measure_targets(drawn_rings(own.codes), "a", TargetSearch(own, with_uncoded=False))
    assert found.fitting_bits is None
    assert len(found.detections) == 6
