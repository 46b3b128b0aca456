"""Candidates in a photo: sizes, tilts, polarities, depths, borders, empty ground."""

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray
from photogrammetry.detection import detect
from photogrammetry.detection.detect import SearchLimits, find_candidates
from photogrammetry.targets.ring_codes import Polarity
from tests.photogrammetry.drawing import blurred_coverage, tilted


def scene(forms: list[tuple[float, float, FloatArray]], *, dark: bool = True) -> FloatArray:
    """Targets on plain ground with noise."""
    covered = np.zeros((240, 320))
    for x, y, form in forms:
        covered += blurred_coverage(covered.shape, np.array([x, y]), form, 0.6)
    levels = (200.0, -150.0) if dark else (40.0, 150.0)
    return levels[0] + levels[1] * covered + np.random.default_rng(0).normal(0, 1.5, covered.shape)


FORMS = [
    (60.3, 60.1, tilted(6)),
    (120.7, 60.4, tilted(12, tilt_rad=1.0, turn_rad=0.8)),
    (200.2, 80.6, tilted(96)),
    (60.9, 170.2, tilted(40, tilt_rad=np.deg2rad(65), turn_rad=-0.6)),
    (140.1, 180.3, tilted(22)),
]


@pytest.mark.slow
@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_all_sizes_tilts_polarities_and_depths(dark: bool, kind: str) -> None:
    values = scene(FORMS, dark=dark)
    image = np.rint(values * (257 if kind == "uint16" else 1)).astype(kind)
    found = find_candidates(image)
    places = np.array([candidate.ellipse.center_px for candidate in found])
    for x, y, _ in FORMS:
        assert np.hypot(*(places - [x, y]).T).min() < 0.1
    assert len(found) == len(FORMS)
    assert {candidate.polarity for candidate in found} == {Polarity.BLACK_ON_WHITE if dark else Polarity.WHITE_ON_BLACK}


def test_only_the_polarity_asked_for() -> None:
    image = np.rint(scene(FORMS)).astype(np.uint8)
    assert find_candidates(image, SearchLimits(polarities=(Polarity.WHITE_ON_BLACK,))) == ()


def test_squares_and_stripes_are_no_targets() -> None:
    image = np.full((200, 200), 200, dtype=np.uint8)
    image[40:44, 20:180] = 30
    image[100:140, 60:160] = 30
    assert find_candidates(image) == ()


def test_noise_has_no_targets() -> None:
    noise = np.random.default_rng(5).normal(120, 8, (400, 400)).clip(0, 255).astype(np.uint8)
    assert len(find_candidates(noise)) == 0


def test_targets_cut_by_the_border_are_left_out() -> None:
    image = np.rint(scene([(3.0, 100.0, tilted(20)), (100.0, 100.0, tilted(20))])).astype(np.uint8)
    assert len(find_candidates(image)) == 1


def test_limits_that_no_target_has_are_refused() -> None:
    with pytest.raises(InputError, match="diameters"):
        SearchLimits(smallest_px=1)
    with pytest.raises(InputError, match="tilt"):
        SearchLimits(most_tilt_rad=1.6)
    with pytest.raises(InputError, match="grey image"):
        find_candidates(np.zeros((50, 50, 3), dtype=np.uint8))


def test_flat_spots_are_searched_where_their_narrow_side_suits() -> None:
    # Half as fine, a dot of 30 x 10 px merges with its code ring: the gap is five pixels wide.
    angles = np.arange(90) * (2 * np.pi / 90)
    line = np.rint(np.stack([40 + 15 * np.cos(angles), 40 - 5 * np.sin(angles)], axis=1)).astype(np.int32)
    shapes, centers = detect._ellipses_of_lines([line], 1, SearchLimits(), (2.0, 16.0))
    assert len(shapes) == 1
    assert np.allclose(centers, 40, atol=0.2)
    wide = np.rint(np.stack([40 + 15 * np.cos(angles), 40 - 12 * np.sin(angles)], axis=1)).astype(np.int32)
    assert len(detect._ellipses_of_lines([wide], 1, SearchLimits(), (2.0, 16.0))[0]) == 0
