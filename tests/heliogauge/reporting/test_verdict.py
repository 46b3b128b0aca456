"""The verdict: green only where nothing is doubtful and nothing is missing."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.doubts import Doubt, Severity
from heliogauge.flags import SampleFlag
from heliogauge.reporting import page
from heliogauge.reporting.html import Html
from heliogauge.reporting.verdict import State, first_clause, holes, verdict_of
from heliogauge.results.folder import Summary
from tests.heliogauge.reporting.test_report import make_map

NOTE = Doubt("a", "good to know", severity=Severity.NOTE)
DOUBT = Doubt("b", "the curl is 4 times its sigma; check the screen")
SERIOUS = Doubt("c", "slopes 40 mrad off the design. Nothing can be used", severity=Severity.SERIOUS)


def summary(*doubts: Doubt) -> Summary:
    return Summary("deflectometry", "facet", {}, doubts=doubts)


@pytest.mark.parametrize(
    ("doubts", "missing", "state"),
    [
        ((), (), State.SOUND),
        ((NOTE,), (), State.SOUND),
        ((DOUBT, NOTE), (), State.DOUBTFUL),
        ((), ("36.7 % of the mirror not measured",), State.INCOMPLETE),
        ((DOUBT,), ("36.7 % of the mirror not measured",), State.INCOMPLETE),
        ((NOTE, SERIOUS), ("36.7 % of the mirror not measured",), State.FAILED),
        ((SERIOUS,), (), State.FAILED),
    ],
)
def test_the_state_is_that_of_the_worst(doubts: tuple[Doubt, ...], missing: tuple[str, ...], state: State) -> None:
    verdict = verdict_of(summary(*doubts), missing)
    assert verdict.state is state
    box = page.verdict_box(verdict).text
    assert f'class="verdict {state}"' in box
    assert all(text in box for text in missing)


def test_a_box_over_a_hole_is_never_green() -> None:
    whole = make_map()
    x, _ = np.meshgrid(whole.x_m, whole.y_m)
    for share in np.linspace(0.02, 0.98, 13):
        hole = x < whole.x_m[0] + share * np.ptp(whole.x_m)
        holed = replace(whole, slope_x=np.where(hole, np.nan, whole.slope_x), flags=np.where(hole, 4, 0).astype("u4"))
        verdict = verdict_of(summary(), holes(holed))
        assert verdict.state is State.INCOMPLETE
        said = float(verdict.missing[0].partition(" ")[0])
        assert said == pytest.approx(100 * (1 - holed.measured_share), abs=0.051)


def test_a_map_without_a_mirror_is_not_measured() -> None:
    whole = make_map()
    assert holes(replace(whole, aperture=np.zeros(whole.shape, bool))) == ("100.0 % of the mirror not measured",)


def test_the_strip_along_the_edge_is_no_hole_unless_it_is_wide() -> None:
    shape = (100, 100)
    rows, columns = np.indices(shape)
    depth = np.minimum.reduce([rows, columns, shape[0] - 1 - rows, shape[1] - 1 - columns])
    whole = make_map()
    for strip, holed in ((2, False), (3, False), (4, True)):
        edge = depth < strip
        slopes = np.where(edge, np.nan, 0.0)
        flags = np.where(edge, np.uint32(SampleFlag.MIRROR_EDGE), np.uint32(0))
        grid = np.linspace(-1, 1, 100)
        arrays = {name: np.zeros(shape) for name in ("design_slope_x", "design_slope_y", "height_m")}
        sigma = {name: np.full(shape, 1e-5) for name in ("sigma_random_x", "sigma_random_y")}
        mirror = replace(
            whole,
            x_m=grid,
            y_m=grid,
            slope_x=slopes,
            slope_y=slopes,
            flags=flags,
            aperture=np.ones(shape, bool),
            **arrays,
            **sigma,
        )
        assert bool(holes(mirror)) is holed


def test_a_verdict_is_short_and_leads_to_the_words() -> None:
    many = [Doubt(f"d{number}", f"doubt number {number} {'x' * number}; more of it") for number in range(9)]
    verdict = verdict_of(summary(NOTE, *many, SERIOUS), passed=("outline fits to 0.02 px",))
    assert verdict.doubtful[0].text == "slopes 40 mrad off the design"
    lengths = [len(one.text) for one in verdict.doubtful[1:]]
    assert lengths == sorted(lengths)
    box = page.verdict_box(verdict).text
    assert 'href="#doubt-11"' in box
    assert "and 5 more" in box
    assert "more of it" not in box
    assert "1 note<" in box


def test_long_clauses_are_cut_at_a_word() -> None:
    text = first_clause("word " * 60)
    assert len(text) < 115
    assert text.endswith("word \u2026")


def test_text_on_the_first_screen_stays_text() -> None:
    verdict = verdict_of(summary(replace(DOUBT, text="<b>x</b>")), ("<i>",), ("<u>",))
    shown = page.first_screen("<h6>", "<s>", verdict, [("<q>", "<p>1", "<em>")], Html("PICTURE")).text
    assert "PICTURE" in shown
    assert not any(f"<{tag}>" in shown for tag in ("b", "i", "u", "s", "q", "em", "h6"))
    assert "<p>1" not in shown
