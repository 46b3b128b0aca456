"""Curl by neighbouring pixels: of slopes that are known, of noise, and of measurements whose map is judged too."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import load_deflectometry
from deflectometry.pipeline import contradictions
from deflectometry.pipeline.choices import Choices
from deflectometry.pipeline.curl_test import CurlRemedies, curl_doubt
from deflectometry.pipeline.evaluate import map_slopes, solve_reflection
from deflectometry.pipeline.few_slopes import contradicted_by_few, pixel_curl
from deflectometry.pipeline.headline import curl_numbers
from deflectometry.pipeline.images import image_files, observe
from deflectometry.pipeline.inputs import build_pattern, build_setup, describe_mirror
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.sources.sample_grid import PixelGrid
from heliogauge.images.photos import read_frames
from heliogauge.running.progress import SilentProgress


def slope_image(slope_x, slope_y, x_m, y_m, sigma=1e-5) -> SlopeImage:
    sigmas = np.full((2, *x_m.shape), sigma, dtype=np.float32)
    return SlopeImage(
        0, 0, x_m, y_m, slope_x, slope_y, sigmas[0], sigmas[1], np.zeros(x_m.shape, dtype=np.uint32), PixelGrid()
    )


@pytest.fixture
def places():
    """Pixels of 14 mm, turned by 20 deg and sheared, y upwards."""
    row, column = np.mgrid[:40, :50] * 0.014
    return 0.94 * column + 0.34 * row, 0.31 * column - 0.90 * row


def test_curl_of_planes(places) -> None:
    x, y = places
    found = pixel_curl(slope_image(0.02 * x + 0.007 * y, 0.003 * x - 0.05 * y, x, y))
    assert found.measured_per_m == pytest.approx(0.004, rel=1e-9)
    surface = pixel_curl(slope_image(0.02 * x + 0.007 * y, 0.007 * x - 0.05 * y, x, y))
    assert surface.measured_per_m < 1e-12


def test_curl_of_noise_is_as_expected(places) -> None:
    x, y = places
    noise = np.random.default_rng(2).normal(0, 1e-5, (2, *x.shape))
    noise[0, 3, 4] = np.nan
    found = pixel_curl(slope_image(*noise, x, y))
    assert found.measured_per_m == pytest.approx(found.expected_per_m, rel=0.05)


def test_nothing_beside_each_other_says_nothing(places) -> None:
    x, y = places
    apart = np.where(np.indices(x.shape).sum(axis=0) % 2, np.nan, 1.0)
    assert np.isnan(pixel_curl(slope_image(apart, apart, x, y))).all()


def said_by_few_and_by_the_map(tmp_path, change):
    """Codes that some pixels yield, and those that the curl of the map yields."""
    write_dataset(tmp_path / "m", preset_scene("small"), DatasetOptions(0, Knowledge()))
    measurement = load_deflectometry(tmp_path / "m")
    setup, pattern = build_setup(measurement), build_pattern(measurement)
    source = observe(measurement, pattern, read_frames(image_files(measurement)))
    mirror = describe_mirror(measurement, setup)
    sound = solve_reflection(source, setup, mirror, Choices(), SilentProgress())
    curls = {name: curl_numbers(one) for name, one in map_slopes(sound, setup, SilentProgress()).fine_maps.items()}
    seen = replace(sound.screen_map, **change(sound.screen_map))
    looked = solve_reflection(replace(source, seen=seen), setup, mirror, Choices(), SilentProgress())
    own = {name: curl_numbers(one) for name, one in map_slopes(looked, setup, SilentProgress()).fine_maps.items()}
    by_map = curl_doubt(own, CurlRemedies.of_source(source.remedies))
    few = contradicted_by_few(looked, setup, source.remedies, curls)
    return {one.code for one in few}, {one.code for one in by_map}


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        (lambda seen: {}, set()),
        (lambda seen: {"u": seen.v, "v": seen.u}, {"slopes_of_no_surface"}),
        (lambda seen: {"u": 1 - seen.u, "v": 1 - seen.v}, {"slopes_too_far_off_design"}),
    ],
    ids=["as it is", "axes exchanged", "turned"],
)
def test_few_pixels_of_a_drawn_facet(tmp_path, change, codes) -> None:
    found, _ = said_by_few_and_by_the_map(tmp_path, change)
    assert codes <= found
    assert bool(codes) == bool(found.intersection(contradictions._CONTRADICTIONS))


@pytest.mark.parametrize(
    ("count", "off", "of_few", "of_map"),
    [(7, 0.0019, False, False), (60, 0.0025, True, True)],
    ids=["3.1 times the noise, on the map 2.9", "12 times the noise"],
)
def test_some_pixels_do_not_refuse_what_the_map_accepts(tmp_path, count, off, of_few, of_map) -> None:
    """Bad pixels on their own count for more among their neighbours than on the grid of the map."""

    def spoilt(seen):
        u = seen.u.copy()
        u.flat[np.random.default_rng(4).choice(np.flatnonzero(seen.flags == 0), count, replace=False)] += off
        return {"u": u}

    few, by_map = said_by_few_and_by_the_map(tmp_path, spoilt)
    assert ("slopes_of_no_surface" in few) == of_few
    assert ("slopes_of_no_surface" in by_map) == of_map
