"""Offset, tilt and sag of the tube: beams held in different ways, gravity, hidden supports, sigmas, warnings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.results.tables import write_table_csv
from observer.absorber.position import AbsorberSolution, StationFate
from observer.absorber.product import absorber_columns, absorber_doubts, shape_numbers, span_columns, tube_spans
from observer.absorber.shape import alignment, spans, supports_of
from observer.files import read_absorber
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2

COLLECTOR = replace(ls2(), support_y_m=np.array([-3.945, 0.0, 3.945]))
Y_M = np.linspace(-3.945, 3.945, 33)
VISIBLE = np.abs(Y_M[:, None] - COLLECTOR.support_y_m).min(axis=1) > 0.15


def path_of(x_m: np.ndarray, z_m: np.ndarray, covariance: np.ndarray | None = None) -> AbsorberPath:
    return AbsorberPath(Y_M, x_m, 1.49 + z_m, 1e-10 * np.eye(66) if covariance is None else covariance)


def solution_of(path: AbsorberPath, diameter_m: float = 0.070) -> AbsorberSolution:
    fate = np.where(VISIBLE, int(StationFate.MEASURED), int(StationFate.HIDDEN))
    return AbsorberSolution(path, np.where(VISIBLE, 5, 0), fate, np.ones(3, dtype=bool), 1e-5, diameter_m)


@pytest.mark.parametrize(
    "shape",
    [lambda u: 16 * (u * (1 - u)) ** 2, lambda u: 4 * u * (1 - u), lambda u: 3.2 * (u - 2 * u**3 + u**4)],
    ids=["clamped", "parabola", "resting"],
)
def test_sag_of_beams_held_in_different_ways(shape: object) -> None:
    # w = 1 in the middle of each span; what the supports hide is not known.
    u = (Y_M + 3.945) / 3.945 % 1.0
    z = -6e-3 * shape(u) + 2e-3 + 1e-3 * Y_M
    hidden = np.where(VISIBLE, 0.0, 0.05)
    found = spans(path_of(np.zeros(33) + hidden, z + hidden), VISIBLE, COLLECTOR.support_y_m, 0.0)
    assert [(span.from_y_m, span.to_y_m) for span in found] == [(-3.945, 0.0), (0.0, 3.945)]
    for span in found:
        np.testing.assert_allclose([span.sag_x_m, span.sag_z_m, span.sag_down_m], [0.0, -6e-3, 6e-3], atol=1e-9)


def test_down_turns_with_the_collector() -> None:
    # The right hand about +y turns the optical axis to the world's +x: at 90 degrees down is the trough's +x.
    shape = 1 - (Y_M / 3.945) ** 2
    path = path_of(4e-3 * shape, np.zeros(33))
    ends = np.array([-3.945, 3.945])
    for degrees, down in ((90.0, 4e-3), (-90.0, -4e-3), (0.0, 0.0), (30.0, 2e-3)):
        (span,) = spans(path, np.ones(33, dtype=bool), ends, np.radians(degrees))
        np.testing.assert_allclose(span.sag_down_m, down, atol=1e-12)


def test_sigmas_are_the_scatter() -> None:
    rng = np.random.default_rng(2)
    root = 1e-4 * rng.standard_normal((66, 66))
    covariance = root @ root.T
    sags, lines = [], []
    for _ in range(300):
        noise = root @ rng.standard_normal(66)
        path = path_of(noise[:33], noise[33:], covariance)
        sags.append(spans(path, VISIBLE, COLLECTOR.support_y_m, 0.4)[0])
        lines.append(alignment(path, VISIBLE, 1.49))
    for name in ("sag_x_m", "sag_z_m", "sag_down_m"):
        scatter = np.std([getattr(span, name) for span in sags])
        np.testing.assert_allclose(scatter, getattr(sags[0], f"sigma_{name}"), rtol=0.15)
    for name in ("offset_x_m", "offset_z_m", "tilt_x_rad", "tilt_z_rad"):
        scatter = np.std([getattr(line, name) for line in lines])
        np.testing.assert_allclose(scatter, getattr(lines[0], f"sigma_{name}"), rtol=0.15)


def test_offset_and_tilt_of_a_straight_tube() -> None:
    line = alignment(path_of(3e-3 + 4e-4 * Y_M, -5e-3 - 3e-4 * Y_M), VISIBLE, 1.49)
    np.testing.assert_allclose(
        [line.offset_x_m, line.offset_z_m, line.tilt_x_rad, line.tilt_z_rad], [3e-3, -5e-3, 4e-4, -3e-4], atol=1e-12
    )


def test_supports_that_nobody_listed_are_where_the_tube_is_hidden() -> None:
    unlisted = replace(COLLECTOR, support_y_m=np.zeros(0))
    path = path_of(np.zeros(33), np.zeros(33))
    np.testing.assert_allclose(supports_of(path, VISIBLE, unlisted), [-3.945, 0.0, 3.945], atol=1e-12)
    np.testing.assert_allclose(supports_of(path, np.ones(33, dtype=bool), unlisted), [-3.945, 3.945])


def test_a_span_of_which_too_little_is_seen_has_no_sag() -> None:
    few = VISIBLE & (Y_M < -3.0) | (Y_M > 0.2)
    first, second = spans(path_of(np.zeros(33), np.zeros(33)), few, COLLECTOR.support_y_m, 0.0)
    assert np.isnan(first.sag_z_m)
    assert np.isnan(first.sigma_sag_z_m)
    assert second.sag_z_m == pytest.approx(0.0, abs=1e-12)


def test_table_says_why_a_station_has_no_value() -> None:
    path = path_of(np.zeros(33), np.zeros(33))
    table = absorber_columns(path, solution_of(path), COLLECTOR)
    assert table["reason"][16] == "hidden by a receiver support"
    assert np.isnan(table["x_a_m"][16])
    assert table["flag"][16] != 0
    assert table["reason"][5] == ""
    assert table["flag"][5] == 0
    assert table["z_a_m"][5] == 1.49
    bare = absorber_columns(path, solution_of(path), replace(COLLECTOR, support_y_m=np.zeros(0)))
    assert "fewer than two photos" in bare["reason"][16]
    assert absorber_columns(path, None, COLLECTOR)["flag"].max() == 0
    spans_table = span_columns(tube_spans(path, solution_of(path), COLLECTOR, 0.0))
    assert spans_table["from_y_m"] == [-3.945, 0.0]


def test_a_table_of_an_earlier_result_is_read_without_the_stations_that_were_hidden(tmp_path: Path) -> None:
    path = path_of(4e-4 * Y_M, 2e-3 * np.cos(Y_M), 4e-8 * np.eye(66))
    write_table_csv(tmp_path / "absorber.csv", absorber_columns(path, solution_of(path), COLLECTOR))
    again = read_absorber(tmp_path / "absorber.csv")
    np.testing.assert_allclose(again.y_m, Y_M[VISIBLE])
    np.testing.assert_allclose(again.z_m, path.z_m[VISIBLE])
    np.testing.assert_allclose(again.sigma_at(again.y_m)[0], 2e-4)
    (tmp_path / "empty.csv").write_text("y_m,x_a_m,z_a_m,sigma_x_a_m,sigma_z_a_m\n0,,,,\n", encoding="utf-8")
    with pytest.raises(InputError, match="no row is complete"):
        read_absorber(tmp_path / "empty.csv")


def test_numbers_and_what_is_warned_of() -> None:
    u = (Y_M + 3.945) / 3.945 % 1.0
    path = path_of(4e-4 * Y_M, -6e-3 * 16 * (u * (1 - u)) ** 2)
    numbers = shape_numbers(path, solution_of(path), COLLECTOR, 0.0)
    np.testing.assert_allclose(numbers["absorber_sag_down_m"], 6e-3, atol=1e-9)
    np.testing.assert_allclose(numbers["absorber_tilt_x_rad"], 4e-4, atol=1e-9)
    assert numbers["absorber_stations_measured_count"] == VISIBLE.sum()
    assert numbers["absorber_spans_measured_count"] == 2
    assert list(absorber_doubts(path, solution_of(path), COLLECTOR, is_design=False)) == []
    unlisted = replace(COLLECTOR, support_y_m=np.zeros(0))
    (doubt,) = absorber_doubts(path, solution_of(path), unlisted, is_design=False)
    assert "hidden about y = 0.00 m, as by supports, of which support_y_m says nothing" in doubt.text
    # Five photos of 33 stations miss one by chance, as before clouds; of twenty none does.
    assert "clouds" in doubt.text
    assert doubt.numbers["by_chance_probability"] > 0.5
    often = replace(solution_of(path), n_photos=np.where(VISIBLE, 20, 0))
    (doubt,) = absorber_doubts(path, often, unlisted, is_design=False)
    assert "clouds" not in doubt.text
    assert doubt.numbers["by_chance_probability"] == pytest.approx(33 * 21 * np.exp(-20))
    (doubt,) = absorber_doubts(path, solution_of(path, 0.075), COLLECTOR, is_design=False)
    assert "looks 75.0 mm thick" in doubt.text
    # With pixels of 12.3 mm 3 % are a sixth of one, as much as blur does.
    for diameter, doubted in ((0.0674, False), (0.0723, False), (0.0745, True)):
        coarse = replace(solution_of(path, diameter), pixel_m=12.3e-3)
        assert bool(list(absorber_doubts(path, coarse, COLLECTOR, is_design=False))) == doubted
    (doubt,) = absorber_doubts(path, None, COLLECTOR, is_design=True)
    assert "not measured" in doubt.text
    assert "0.34 mrad" in doubt.text
    vague = path_of(path.x_m, path.z_m - 1.49, 4e-6 * np.eye(66))
    (doubt,) = absorber_doubts(vague, solution_of(vague), COLLECTOR, is_design=False)
    assert "uncertain by 2.0 mm" in doubt.text
    given = shape_numbers(AbsorberPath.straight(0.0, 1.49, 3.9), None, Collector(5.0, 7.8, 1.49, 0.07), 0.0)
    assert "absorber_sag_down_m" not in given
