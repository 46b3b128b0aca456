"""Which edges of a photo can be the tube's: by darkness, by how they go on from row to row."""

from dataclasses import replace

import numpy as np

from observer.photo_edges.edges import Edges
from observer.photo_edges.rectify import Strip
from observer.photo_edges.reflection_edges import (
    ReflectionEdges,
    _is_lesser_step,
    _is_tube_dark,
    _Look,
    _unevenness,
    joined,
)
from observer.selection.edge_refusal import EdgeFate, first_fate, has_shadows, is_alone, unchecked_doubt

Y = np.arange(50) * 0.02


def curve(photo: int, rows: np.ndarray, x: np.ndarray) -> ReflectionEdges:
    n = rows.size
    points = np.stack([x, Y[rows], np.zeros(n)], axis=1)
    none = np.zeros(n)
    return ReflectionEdges(
        np.full(n, photo), rows, np.ones(n), points, np.full(n, 1e-3), np.full(n, -0.8), none, none > 0
    )


def test_short_curves_are_refused_whatever_lies_beside_them_in_other_photos() -> None:
    long = curve(0, np.arange(40), 0.1 + 0.05 * np.arange(40))
    short = curve(0, np.arange(10, 14), np.full(4, -0.5))
    elsewhere = curve(1, np.arange(14, 40), np.full(26, -0.5))
    jump = curve(1, np.arange(3), np.full(3, -0.2))
    edges = ReflectionEdges(
        *(
            np.concatenate([getattr(one, name) for one in (long, short, elsewhere, jump)])
            for name in ReflectionEdges.__slots__
        )
    )
    alone = is_alone(edges, np.ones(edges.row.size, dtype=bool), Y)
    np.testing.assert_array_equal(alone, np.repeat([False, True, False, True], [40, 4, 26, 3]))
    # Rows 0.4 m apart do not show how an edge goes on.
    assert not is_alone(edges, np.ones(edges.row.size, dtype=bool), 20 * Y).any()


def test_rows_at_the_limit_show_how_edges_go_on_wherever_they_are() -> None:
    short = curve(0, np.arange(10, 14), np.full(4, -0.5))
    for start in (0.0, -0.15, -1.9, 7.3):
        rows = start + 0.05 * np.arange(50)
        assert is_alone(short, np.ones(4, dtype=bool), rows).all()


def test_edges_beside_a_curve_in_single_rows_do_not_go_on_with_it() -> None:
    """As in a rendered photo: 80 mm beside the tube's edge, in some rows of ten."""
    long = curve(0, np.arange(40), -1.6 + 0.002 * np.arange(40))
    beside = curve(0, np.array([7, 8, 10, 12]), np.array([-1.52, -1.51, -1.52, -1.51]))
    edges = ReflectionEdges(
        *(np.concatenate([getattr(one, name) for one in (long, beside)]) for name in ReflectionEdges.__slots__)
    )
    alone = is_alone(edges, np.ones(edges.row.size, dtype=bool), Y)
    np.testing.assert_array_equal(alone, np.repeat([False, True], [40, 4]))


def test_noise_that_does_not_go_on_from_row_to_row_is_no_shadow() -> None:
    rng = np.random.default_rng(1)
    tube = [curve(photo, np.arange(40), 0.1 + 0.05 * np.arange(40)) for photo in range(20)]
    noise = [curve(photo, np.arange(0, 40, 8), rng.uniform(-2, 2, 5)) for photo in range(20)]
    shadow = [curve(photo, np.arange(10, 20), np.full(10, -0.5)) for photo in range(20)]
    for wrong, is_shadow in ((noise, False), (shadow, True)):
        edges = ReflectionEdges(
            *(np.concatenate([getattr(one, name) for one in (*tube, *wrong)]) for name in ReflectionEdges.__slots__)
        )
        fate = np.full(edges.row.size, int(EdgeFate.USED))
        fate[800:] = int(EdgeFate.WRONG_STEP)
        assert has_shadows(edges, fate, Y) is is_shadow


def test_lesser_steps_do_not_hide_shadows() -> None:
    """One edge in a hundred is a shadow's; with the rim of the glass beside each of the tube's, one in two hundred."""
    tube = [curve(photo, np.arange(50), np.full(50, 0.1)) for photo in range(100)]
    rims = [curve(photo, np.arange(50), np.full(50, 0.12)) for photo in range(100)]
    shadow = curve(0, np.arange(50), np.full(50, -0.5))
    fate = np.repeat([EdgeFate.USED, EdgeFate.WRONG_STEP, EdgeFate.LESSER_STEP], [5000, 50, 5000])
    assert has_shadows(joined([*tube, shadow]), fate[:5050], Y)
    assert has_shadows(joined([*tube, shadow, *rims]), fate, Y)


def edges_between(dark: np.ndarray, bright: np.ndarray) -> Edges:
    n = dark.size
    rise = dark - bright
    return Edges(np.arange(n), np.zeros(n), np.full(n, 1e-3), rise, rise / bright)


def test_edges_of_bright_things_are_refused() -> None:
    rng = np.random.default_rng(0)
    tube = edges_between(np.full(60, 18.0) + rng.normal(0, 1, 60), rng.uniform(80, 200, 60))
    ground = edges_between(rng.uniform(60, 90, 60), rng.uniform(130, 200, 60))
    both = Edges(*(np.concatenate([getattr(one, name) for one in (tube, ground)]) for name in Edges.__slots__))
    everything = np.ones(120, dtype=bool)
    kept = _is_tube_dark(both, np.ones(120), everything)
    np.testing.assert_array_equal(kept, np.repeat([True, False], 60))
    # Steps the other way: a bright tube is not judged by its darkness.
    assert _is_tube_dark(both, -np.ones(120), everything).all()


def test_of_two_steps_on_the_way_to_the_tube_the_larger_is_its_edge() -> None:
    def row_of(levels: list[float], row: int) -> Edges:
        level = np.array(levels)
        rise, brighter = np.diff(level), np.maximum(level[1:], level[:-1])
        return Edges(
            np.full(rise.size, row), 0.1 * np.arange(rise.size), np.full(rise.size, 1e-3), rise, rise / brighter
        )

    # What the glass throws back ends upon the tube; the rim of the glass before it; two reflections of one tube beside
    # each other; the same before a dark cloud; noise between two steps down; a bright tube before dark ground; three
    # steps, of which the last is more than the second.
    rows = [
        [180, 60, 30, 170],
        [180, 150, 20, 160],
        [180, 20, 170, 20, 180],
        [180, 20, 90, 20, 90],
        [180, 60, 70, 30],
        [20, 60, 190, 30],
        [180, 80, 60, 20],
    ]
    kept = [[1, 0, 1], [0, 1, 1], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 0], [0, 1, 1], [1, 0, 0]]
    parts = [row_of(levels, number) for number, levels in enumerate(rows)]
    found = Edges(*(np.concatenate([getattr(one, name) for one in parts]) for name in Edges.__slots__))
    side, wide = np.sign(found.rise_dn), np.full(found.row.size, 1.0)
    lesser = _is_lesser_step(found, side, found.x_m, wide)
    np.testing.assert_array_equal(~lesser, np.concatenate(kept).astype(bool))
    # Edges of both sides of the tube are no steps on one way.
    assert not _is_lesser_step(parts[0], np.array([-1.0, 1.0, 1.0]), parts[0].x_m, wide[:3]).any()
    # Nor are steps further apart than the receiver is wide.
    assert not _is_lesser_step(found, side, found.x_m, 0.09 * wide).any()


def test_lesser_steps_have_a_fate_and_decide_nothing() -> None:
    """Were they counted, 60 of 100 faint steps would make the usual contrast theirs, and lift steps the other way."""
    tube = curve(0, np.arange(40), np.zeros(40))
    lesser = replace(
        curve(0, np.arange(40).repeat(3), np.full(120, 0.02)),
        contrast=np.full(120, 0.3),
        is_lesser=np.ones(120, dtype=bool),
    )
    edges = ReflectionEdges(
        *(np.concatenate([getattr(one, name) for one in (tube, lesser)]) for name in ReflectionEdges.__slots__)
    )
    np.testing.assert_array_equal(first_fate(edges), np.repeat([EdgeFate.USED, EdgeFate.LESSER_STEP], [40, 120]))


def test_photos_that_show_the_glass_but_not_the_tube_are_refused() -> None:
    """Clouds let the clearest contrasts of 30 photos scatter by 0.03; 0.6 is 8 times that below, 0.8 twice."""
    rng = np.random.default_rng(2)
    tube = [
        replace(one, contrast=-np.clip(level + rng.normal(0, 0.04, 40), 0, 1))
        for level, one in zip(
            rng.normal(0.86, 0.03, 30), (curve(photo, np.arange(40), np.zeros(40)) for photo in range(30)), strict=True
        )
    ]
    for contrast, is_refused in ((0.6, True), (0.8, False)):
        other = replace(curve(30, np.arange(40), np.zeros(40)), contrast=np.full(40, -contrast))
        edges = ReflectionEdges(
            *(np.concatenate([getattr(one, name) for one in (*tube, other)]) for name in ReflectionEdges.__slots__)
        )
        faint = first_fate(edges) == EdgeFate.FAINT
        np.testing.assert_array_equal(faint, np.repeat([False, is_refused], [1200, 40]))


def test_an_edge_beside_which_the_brightness_goes_on_changing_is_uneven() -> None:
    x = np.arange(120) * 0.01
    step = 100.0 / (1 + np.exp(-(x - 0.4) / 0.01)) + 20.0
    # A shadow that ends 5 samples beside the second row's edge.
    shadowed = np.where(x > 0.45, 0.4 * step, step)
    image = np.stack([step, shadowed]).astype(np.float32)
    strip = Strip(image, x, np.ones(image.shape, dtype=bool))
    edges = Edges(np.array([0, 1]), np.full(2, 0.4), np.full(2, 1e-3), np.full(2, 100.0), np.full(2, 0.8))
    even, uneven = _unevenness(_Look(0, np.zeros(3), 0.01, strip), edges)
    assert even < 0.05
    assert uneven > 0.5
    both = curve(0, np.arange(40), np.full(40, 0.1))
    both = replace(both, unevenness=np.where(np.arange(40) < 5, uneven, even))
    np.testing.assert_array_equal(first_fate(both) == EdgeFate.UNEVEN, np.arange(40) < 5)


def test_a_word_is_said_where_most_edges_stand_alone() -> None:
    fate = np.repeat([EdgeFate.USED, EdgeFate.WRONG_STEP, EdgeFate.ONE_SIDED], [40, 10, 50])
    assert "50 % are not confirmed" in str(unchecked_doubt(fate))
    assert unchecked_doubt(fate[:55]) is None
    # Lesser steps, which come with another edge, do not count.
    assert str(unchecked_doubt(np.append(fate, np.full(400, int(EdgeFate.LESSER_STEP))))) == str(unchecked_doubt(fate))
