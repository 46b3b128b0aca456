"""A wrong number in [collector] is named: sentences from known figures, and rims found in drawn photos."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.doubts import Severity
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from observer.doubts.photos import overexposure_doubt, refuse_impossible_cameras, scatter_doubt, sparse_doubt
from observer.doubts.stated_dimensions import Found, diameter_doubt, focal_length_doubt, outline_doubts, panels_doubt
from observer.photo_edges.outline import Span, clipped_share, photos_from_above, plates_of, rims_in_photo, spans_of
from observer.photo_edges.views import View
from observer.slopes.row_spline import Roughness
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, GlassTube, ls2

CAMERA = Camera(480, 640, 1030.0, 1030.0, 239.5, 319.5)
SHORT = Collector(5.0, 3.16, 1.49, 0.070, GlassTube(0.115, 0.109))


def absorber_at(height_m: float) -> AbsorberPath:
    return AbsorberPath.straight(0.0, height_m, 4.0)


def test_focal_length_that_mirror_and_absorber_contradict():
    stated = replace(ls2(), focal_length_m=1.49 * 1.01)
    said = focal_length_doubt(Found(1.490, 5e-4), absorber_at(1.4902), stated)
    assert said is not None
    assert "collector.focal_length_m = 1.5049 m does not fit" in said.text
    assert "1.4900 m (-0.99 %)" in said.text
    assert "the absorber is at that height too" in said.text


@pytest.mark.parametrize(
    ("mirror", "height", "doubted"),
    [
        (Found(1.4871, 5e-4), 1.4900, False),  # a usual mirror: 0.2 %
        (Found(1.4842, 5e-4), 1.4842, True),  # 0.4 %, and the absorber says so too
        (Found(1.4842, 5e-4), 1.4900, False),  # 0.4 %, and the absorber is where it belongs: the panels
        (Found(1.4751, 5e-4), 1.4900, True),  # 1 % is more than panels do
        (Found(1.4751, 5e-3), 1.4900, False),  # not known well enough
        (Found(1.4950, 5e-4), 1.5043, True),  # 0.3 % by panels that are bent, 1 % by the absorber
        (Found(1.4860, 5e-4), 1.4840, False),  # 0.3 %, and an absorber 6 mm too low
        (Found(1.4860, 5e-4), 1.5040, False),  # the absorber says the opposite
    ],
)
def test_when_the_focal_length_is_doubted(mirror, height, doubted):
    assert (focal_length_doubt(mirror, absorber_at(height), ls2()) is not None) == doubted


@pytest.mark.parametrize(
    ("diameter", "sigma", "doubted"),
    [(0.0693, 3e-5, True), (0.0698, 3e-5, False), (0.0693, 3e-4, False), (0.077, 1e-4, True)],
)
def test_when_the_diameter_is_doubted(diameter, sigma, doubted):
    said = diameter_doubt(Found(diameter, sigma), ls2())
    assert (said is not None) == doubted
    if said is not None:
        assert "collector.absorber_diameter_mm = 70 mm" in said.text


def test_width_length_and_origin_by_name():
    design = ls2()
    good = Span(5.001, 1e-3, 0.0), Span(7.889, 1e-3, 0.001)
    assert list(outline_doubts(*good, design)) == []
    (wide,) = outline_doubts(Span(4.95, 1e-3, 0.0), good[1], design)
    assert "collector.aperture_width_m = 5 m does not fit" in wide.text
    assert "-2.475 and 2.475 m, which makes 4.950 m (-1.0 %)" in wide.text
    (long,) = outline_doubts(good[0], Span(7.97, 1e-3, 0.0), design)
    assert "collector.length_m = 7.89 m" in long.text
    (moved,) = outline_doubts(Span(5.0, 1e-3, 0.08), good[1], design)
    assert "middle is at x = 0.080 m" in moved.text
    assert list(outline_doubts(Span(np.nan, np.inf, np.nan), Span(np.nan, np.inf, np.nan), design)) == []


def test_cameras_where_none_can_be():
    above = np.array([[-2.0, 0.0, 12.0], [0.0, 0.1, 12.0], [2.0, 0.0, 12.0]])
    rims = np.array([[x, y, 0.9] for x in (-2.6, 2.6) for y in (-3.8, 0.0, 3.8)])
    refuse_impossible_cameras(above, rims, ls2())
    with pytest.raises(InputError, match=r"the list is mirrored. x must .* turns the result by 180 degrees"):
        refuse_impossible_cameras(above * [1.0, 1.0, -1.0], rims * [1.0, -1.0, 1.0], ls2())
    with pytest.raises(InputError, match=r"columns x_m and y_m seem exchanged: it spreads over 7.60 m in x and 5.20 m"):
        refuse_impossible_cameras(above * [1.0, 1.0, -1.0], rims[:, [1, 0, 2]], ls2())
    with pytest.raises(InputError, match=r"12\d{3} m away .* are the coordinates in metres"):
        refuse_impossible_cameras(1000 * above, rims, ls2())


def test_overexposed_only_beyond_a_glint():
    assert overexposure_doubt(0.04) is None
    assert overexposure_doubt(float("nan")) is None
    assert "70 % of the mirror is overexposed" in str(overexposure_doubt(0.7))


def test_camera_and_sparse_photos_by_their_figures():
    assert scatter_doubt(0.85, 0.05, 1030.0) is None
    scattered, moved = scatter_doubt(4.38, 0.1, 1030.0), scatter_doubt(40.0, 0.9, 1030.0)
    assert scattered is not None
    assert moved is not None
    assert "scatter by 0.10 px, 4.4 times what the edges" in str(scattered)
    assert (scattered.severity, moved.severity) == (Severity.DOUBT, Severity.SERIOUS)
    assert moved.numbers["slope_rad"] == pytest.approx(0.5 * 0.9 / 1030)
    eyes = np.column_stack([np.linspace(-3, 3, 4), np.zeros(4), np.full(4, 12.0)])
    assert sparse_doubt(0.8, eyes) is None
    said = str(sparse_doubt(0.15, eyes))
    assert "only 15 % of the mirror" in said
    assert "4 photos some 2.00 m apart" in said
    assert "at most 0.2 m apart" in said


@pytest.mark.parametrize("wrong", [{"aperture_width_m": 5000.0}, {"absorber_diameter_m": 7e-5}])
def test_dimensions_in_other_units_are_refused(wrong):
    with pytest.raises(InputError, match="are the units right"):
        Collector(
            **{"aperture_width_m": 5.0, "length_m": 7.9, "focal_length_m": 1.49, "absorber_diameter_m": 0.07} | wrong
        )


def camera_above(x_m: float) -> View:
    """A camera 12 m above that looks down; its x is the trough's y."""
    turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return View(CAMERA, RigidTransform(turn, -turn @ np.array([x_m, 0.0, 12.0])))


def drawn_mirror(
    collector: Collector,
    view: View,
    rng: np.random.Generator,
    *,
    behind: float = 70.0,
    plate: float = 0.1,
) -> np.ndarray:
    """A bright mirror before dark ground, with dark plates for targets, found pixel by pixel on the parabola."""
    camera, pose = view
    height, width = camera.height_px, camera.width_px
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)
    eye = pose.inverse().translation_m
    rays = pose.inverse().rotation @ np.moveaxis(camera.cast_rays(pixels), -1, 0)
    reach = np.full(len(pixels), eye[2])
    for _ in range(30):
        x = eye[0] + reach * rays[0] / -rays[2]
        reach = eye[2] - np.minimum(x**2 / (4 * collector.focal_length_m), 1.2)
    y = eye[1] + reach * rays[1] / -rays[2]
    bright = (np.abs(x) < collector.aperture_width_m / 2) & (np.abs(y) < collector.length_m / 2)
    picture = np.where(bright, 190.0, behind)
    for place in (-1.2, 0.1, 1.3):
        picture[(np.abs(np.abs(x) - 2.6) < 0.1) & (np.abs(y - place) < plate)] = 10.0
    return np.clip(picture + rng.normal(0, 2, picture.size), 0, 255).astype(np.uint8).reshape(height, width)


def drawn_with_markers(view: View, middles: list[tuple[float, float]], rng: np.random.Generator) -> np.ndarray:
    """A mirror little brighter than the ground, with black squares of 0.26 m around places beside it."""
    image = drawn_mirror(SHORT, view, rng, behind=160.0, plate=0.0).astype(float)
    camera, pose = view
    for x, y in middles:
        corners = np.array([[x + dx, y + dy, 1.2] for dx in (-0.13, 0.13) for dy in (-0.13, 0.13)])
        low, high = (
            np.round(edge(camera.project(pose.apply(corners)), axis=0)).astype(int) for edge in (np.min, np.max)
        )
        image[max(low[1], 0) : high[1] + 1, max(low[0], 0) : high[0] + 1] = 10.0
    return image.astype(np.uint8)


@pytest.fixture(scope="module")
def seven():
    views = [camera_above(x) for x in np.linspace(-0.9, 0.9, 7)]
    rng = np.random.default_rng(4)
    return [drawn_mirror(SHORT, view, rng) for view in views], views


@pytest.mark.parametrize("wrong", [{}, {"aperture_width_m": 5.05}, {"aperture_width_m": 4.95, "length_m": 3.19}])
def test_rims_are_found_where_they_are_whatever_is_stated(seven, wrong):
    """A pixel is 12 mm; targets stand 20 mm beside the rim."""
    images, views = seven
    stated = replace(SHORT, panel_edges_x_m=(), panel_edges_y_m=(), **wrong)
    rims = np.array([rims_in_photo(image, view, stated) for image, view in zip(images, views, strict=True)])
    across, along = spans_of(rims)
    assert across.value_m == pytest.approx(5.0, abs=5e-3)
    assert along.value_m == pytest.approx(3.16, abs=5e-3)
    assert across.sigma_m < 5e-3
    named = {one.text.split()[0] for one in outline_doubts(across, along, stated)}
    assert named == {f"collector.{key}" for key in wrong}


def test_no_rim_in_a_photo_without_one(seven):
    images, views = seven
    grey = np.random.default_rng(1).normal(120, 5, images[0].shape).astype(np.uint8)
    rims = np.array([rims_in_photo(grey, view, SHORT) for view in views])
    assert list(outline_doubts(*spans_of(rims), SHORT)) == []


def test_no_width_from_plates_beside_a_mirror_as_bright_as_what_is_behind_it(seven):
    """Targets of half a metre leave steps at two places as large as each other, and none at the rim."""
    _, views = seven
    images = [drawn_mirror(SHORT, view, np.random.default_rng(5), behind=190.0, plate=0.5) for view in views]
    rims = np.array([rims_in_photo(image, view, SHORT) for image, view in zip(images, views, strict=True)])
    across, along = spans_of(rims)
    assert np.isnan(across.value_m)
    assert list(outline_doubts(across, along, SHORT)) == []


def test_square_markers_beside_the_rim_are_not_the_rim(seven):
    """Black borders that begin 70 mm beside a weak rim, along more than half of it."""
    _, views = seven
    rng = np.random.default_rng(6)
    middles = [(side * 2.7, y) for side in (-1, 1) for y in np.linspace(-1.3, 1.3, 6)]
    offsets = 0.13 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    names = [f"{k}.{corner}" for k in range(len(middles)) for corner in range(4)]
    points = np.array([[x + dx, y + dy, 1.1] for x, y in middles for dx, dy in offsets])
    images = [drawn_with_markers(view, middles, rng) for view in views]
    plates = plates_of([*names, "17"], np.vstack([points, [[0.0, 0.0, 0.0]]]))
    assert plates.shape == (12, 4)
    np.testing.assert_allclose(plates[0], [-2.873, -2.527, -1.473, -1.127], atol=1e-3)
    alone, masked = (
        spans_of(
            np.array([rims_in_photo(image, view, SHORT, known) for image, view in zip(images, views, strict=True)])
        )
        for known in (None, plates)
    )
    assert list(outline_doubts(*masked, SHORT)) == []
    assert masked[0].value_m == pytest.approx(5.0, abs=5e-3)
    assert any("aperture_width_m" in one.text for one in outline_doubts(*alone, SHORT))


def test_no_width_from_steps_that_are_elsewhere_in_each_photo():
    rims = np.tile([-2.5, 2.5, -1.58, 1.58], (7, 1))
    assert spans_of(rims)[0].value_m == pytest.approx(5.0)
    rims[:, 1] += np.linspace(0.05, 0.15, 7)
    across, along = spans_of(rims)
    assert np.isnan(across.value_m)
    assert along.value_m == pytest.approx(3.16)


def test_share_at_full_scale(seven):
    images, views = seven
    assert clipped_share(images[0], views[0], SHORT) == 0
    bright = np.where(images[0] > 150, 255, images[0]).astype(np.uint8)
    assert clipped_share(bright, views[0], SHORT) > 0.99
    # 255 of 65535 is dark.
    assert clipped_share(images[0].astype(np.uint16) * 100, views[0], SHORT) == 0


def test_photos_near_the_axis_are_chosen():
    eyes = np.column_stack([np.linspace(-3, 3, 25), np.zeros(25), np.full(25, 12.0)])
    chosen = photos_from_above(eyes)
    assert len(chosen) == 7
    assert np.abs(eyes[chosen, 0]).max() < 1.6
    assert photos_from_above(eyes[:2]) == [0, 1]


def test_jumps_of_the_slopes_ask_for_the_panels() -> None:
    panelled = replace(ls2(), panel_edges_x_m=np.array([-2.5, 0.0, 2.5]))
    whole = replace(ls2(), panel_edges_x_m=np.array([-2.5, 2.5]))
    assert "panel_edges_x_m" in str(panels_doubt(Roughness(0.15), whole))
    assert panels_doubt(Roughness(0.15), panelled) is None
    assert panels_doubt(Roughness(3e-3), whole) is None
    # Waves, however steep, are no panels.
    assert panels_doubt(Roughness(0.15, order=3), whole) is None
