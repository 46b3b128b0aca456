"""Which nodes can show the tube: against lines of sight evaluated one by one, and what is said of a pass too short."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.flags import SampleFlag
from observer.photo_edges.reflection_edges import design_misfit
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2
from observer.trough.visibility import Visibility, coverage_doubt, seeable_shares, visibility

X = (np.arange(100) + 0.5) * 0.05 - 2.5


def trough() -> Collector:
    return replace(ls2(), length_m=4.0, panel_edges_y_m=(), support_y_m=np.array([0.0]), support_width_m=0.3)


def seen_from(eyes: np.ndarray, collector: Collector) -> tuple[np.ndarray, Visibility]:
    y = (np.arange(80) + 0.5) * 0.05 - 2.0
    axis = AbsorberPath.straight(0.0, collector.focal_length_m, 2.0)
    return y, visibility((X, y), eyes, collector, axis, np.zeros((y.size, X.size)))


def line_of_cameras(reach: float, y_m: float = 0.0) -> np.ndarray:
    x = np.linspace(-reach, reach, 201)
    return np.stack([x, np.full_like(x, y_m), np.full_like(x, 15.0)], axis=1)


def test_end_and_support_are_where_reflected_lines_pass_them() -> None:
    collector = trough()
    y, found = seen_from(line_of_cameras(3.0), collector)
    column = 20
    x = float(X[column])
    # The camera that sees the tube's middle by way of this column, at the design's slopes.
    points = np.stack([np.full_like(y, x), y, np.full_like(y, x**2 / (4 * collector.focal_length_m))], axis=1)
    eyes = np.tile([x, 0.0, 15.0], (y.size, 1))
    axis = AbsorberPath.straight(0.0, collector.focal_length_m, 2.0)
    passing = design_misfit(points, eyes, np.ones(y.size), collector, axis).passing_y_m
    beyond = (found.flags[:, column] & SampleFlag.BEYOND_TUBE) > 0
    clear = np.abs(np.abs(passing) - 2.0) > 0.02
    clear &= np.abs(np.abs(passing) - 0.15) > 0.02
    expected = (np.abs(passing) > 2.0) | (np.abs(passing) < 0.15)
    np.testing.assert_array_equal(beyond[clear], expected[clear])
    assert expected.sum() > 8
    assert not found.seeable[beyond, column].any()


def test_receiver_hides_a_strip_in_the_middle() -> None:
    collector = replace(trough(), support_y_m=())
    x = (np.arange(100) + 0.5) * 0.004 - 0.2
    y = np.array([0.0, 0.1])
    axis = AbsorberPath.straight(0.0, collector.focal_length_m, 2.0)
    found = visibility((x, y), line_of_cameras(3.0), collector, axis, np.zeros((2, x.size)))
    hidden = x[(found.flags[0] & SampleFlag.BEHIND_TUBE) > 0]
    # At x the edges are seen from x +- 15 m tan(asin(35 mm / 1.49 m)); the glass is 57.5 mm in radius at 1.49 m.
    away = 15 * np.tan(np.arcsin(0.035 / 1.49))
    half = 0.0575 * np.hypot(away, 15 - 1.49) / (15 - 1.49)
    free = [abs(one + (eye - one) * 1.49 / 15) > half for one in x for eye in (one - away, one + away)]
    expected = x[~np.array(free).reshape(-1, 2).any(axis=1)]
    assert hidden.size > 4
    # What counts as seen from the edge's camera is up to 4 mrad beside it, 6 mm there; nodes are 4 mm apart.
    assert hidden.min() == pytest.approx(expected.min(), abs=0.011)
    assert hidden.max() == pytest.approx(expected.max(), abs=0.011)


def test_short_pass_is_told_where_to_fly() -> None:
    collector = trough()
    _, whole = seen_from(line_of_cameras(3.0), collector)
    aperture = np.ones(whole.flags.shape, dtype=bool)
    assert coverage_doubt(whole, X, aperture, line_of_cameras(3.0)) is None
    eyes = line_of_cameras(3.0)[:120]
    _, part = seen_from(eyes, collector)
    doubt = coverage_doubt(part, X, aperture, eyes)
    assert doubt is not None
    text = doubt.text
    # Photos end at x = 0.57 m; edges there are seen on the mirror up to 0.57 m + 0.3 m.
    missing = X[((part.flags & SampleFlag.NOT_COVERED) > 0).all(axis=0)]
    assert missing.min() == pytest.approx(0.9, abs=0.1)
    assert missing.max() == X[-1]
    assert f"{missing.max():.2f} m" in text
    assert part.camera_to_x_m == pytest.approx(2.5, abs=0.1)
    # What no camera went to see could still show the tube.
    assert part.seeable[40 + 20, -1]


def test_pass_too_short_on_both_sides_and_with_a_gap_names_each_part() -> None:
    all_eyes = line_of_cameras(3.0)
    collector = trough()
    for kept, parts in ((np.abs(all_eyes[:, 0]) < 1.2, 2), (np.abs(all_eyes[:, 0] - 1.0) > 0.7, 1)):
        eyes = all_eyes[kept]
        _, found = seen_from(eyes, collector)
        text = str(coverage_doubt(found, X, np.ones(found.flags.shape, dtype=bool), eyes))
        named = text[text.index("(x = ") : text.index(" m): ")]
        assert named.count(" to ") == parts
        assert ("1.41 m apart at x = 0.30 to 1.71 m" in text) == (parts == 1)


def test_shares() -> None:
    _, found = seen_from(line_of_cameras(3.0), trough())
    aperture = np.ones(found.flags.shape, dtype=bool)
    seeable, measured = seeable_shares(found, aperture, found.seeable)
    assert seeable == pytest.approx(found.seeable.mean())
    assert measured == 1.0
