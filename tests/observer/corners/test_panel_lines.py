"""Gaps and rims of a drawn photo that all lie a little beside where the pose predicts them."""

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import find_lines, line_pieces, lines_in, photo_noise
from observer.photo_edges.views import View
from observer.trough.collector import Collector

BESIDE_PX, NOISE_DN = 0.7, 2.0


def test_all_lines_at_once_are_where_they_were_drawn_and_where_each_alone_is() -> None:
    edges = np.array([-2.5, -1.3, 0.4, 1.3, 2.5]), np.array([-1.5, 0.0, 1.5])
    lattice = PanelLattice(Collector(5.0, 3.0, 1.49, 0.07, None, *edges, 0.01), 2e-3, 1e-3)
    # Seen from straight above, lines along the trough lie along the rows of the photo.
    eye, down = np.array([0.9, 0.1, 12.0]), np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    view = View(Camera(600, 640, 1200.0, 1200.0, 299.5, 319.5), RigidTransform(down, -down @ eye))
    row = np.arange(640.0)
    drawn = np.full(640, 150.0)
    for number, x in enumerate(edges[0]):
        place = float(view.project(np.array([x, 0.0, x**2 / (4 * 1.49)]))[1]) + BESIDE_PX
        if number in (0, edges[0].size - 1):
            outside = row < place if number == 0 else row > place
            drawn = np.where(outside, 60.0, drawn)
        else:
            drawn -= 70 * np.exp(-0.5 * ((row - place) / 0.9) ** 2)
    rng = np.random.default_rng(1)
    image = (drawn[:, None] + NOISE_DN * rng.standard_normal((640, 600))).astype(np.float32)
    # What crosses a gap has large responses in a few of its pieces.
    image[:, 400:408] = 40.0
    noise = photo_noise(image)
    assert abs(noise / NOISE_DN - 1) < 0.1
    wanted = lattice.along_trough
    together, pieces = find_lines(image, view, lattice, 6.0, noise, wanted)
    gaps = [k for k, line in enumerate(wanted) if not line.is_rim and pieces[k]]
    assert len(gaps) >= 4
    for k in gaps:
        found = together[k]
        assert found is not None
        for end in (0.1, 0.9):
            offset, variance = found.at(end)
            assert abs(offset - BESIDE_PX) < 4 * np.sqrt(variance)
        [alone], shown = find_lines(image, view, lattice, 6.0, noise, (wanted[k],))
        assert alone is not None
        assert shown[0] == pieces[k]
        assert np.allclose([alone.offset_px, alone.slope_px, alone.hits], [found.offset_px, found.slope_px, found.hits])
        assert np.allclose(alone.covariance_px2, found.covariance_px2)
    # Photos together: one that shows nothing, and one of more noise, between others leave these as they are.
    noisy = image + 8 * rng.standard_normal(image.shape).astype(np.float32)
    photos = (np.full_like(image, 150.0), 0.1), (image, noise), (noisy, 8.2), (image, noise)
    parts = [line_pieces(one, view, lattice, wanted, 6.0) for one, _ in photos]
    empty, first, between, last = lines_in(parts, wanted, [one for _, one in photos])
    assert not any(empty[0])
    for (some, shown), (one, one_shown) in (
        (first, (together, pieces)),
        (last, (together, pieces)),
        (between, find_lines(noisy, view, lattice, 6.0, 8.2, wanted)),
    ):
        np.testing.assert_array_equal(shown, one_shown)
        assert any(some)
        for found, alone in zip(some, one, strict=True):
            assert (found is None) == (alone is None)
            if found is not None and alone is not None:
                assert (found.offset_px, found.hits) == (alone.offset_px, alone.hits)
                np.testing.assert_array_equal(found.covariance_px2, alone.covariance_px2)


def test_without_lines_nothing_is_found() -> None:
    edges = np.array([-2.5, -1.3, 0.4, 1.3, 2.5]), np.array([-1.5, 0.0, 1.5])
    lattice = PanelLattice(Collector(5.0, 3.0, 1.49, 0.07, None, *edges, 0.01), 2e-3, 1e-3)
    eye, down = np.array([0.9, 0.1, 12.0]), np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    view = View(Camera(600, 640, 1200.0, 1200.0, 299.5, 319.5), RigidTransform(down, -down @ eye))
    image = 150 + NOISE_DN * np.random.default_rng(2).standard_normal((640, 600)).astype(np.float32)
    found, pieces = find_lines(image, view, lattice, 6.0, NOISE_DN)
    assert pieces.any()
    assert not any(found)
    # Far beside the mirror no line is in the photo.
    away = view.posed(RigidTransform(down, -down @ np.array([40.0, 0.1, 12.0])))
    found, pieces = find_lines(image, away, lattice, 6.0, NOISE_DN)
    assert not pieces.any()
    assert not any(found)
