"""Results that contradict themselves: a proven exchange is refused, an open one doubted, and a key has the result."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from deflectometry.pipeline import contradictions
from deflectometry.pipeline.contradictions import judge_contradictions
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError

TURNED = Doubt("reflection_contradicts_outline", "the reflection is 7 sigma off the outline; check all of it")
#: With k1 = -0.1, a focal length of 1000 px and 500 px to the farthest point the other direction moves that by 25 px.
CAMERA = SimpleNamespace(distortion=SimpleNamespace(k1=-0.1), focal_x_px=1000.0)
BENT, BENT_ANOTHER_WAY = (
    Doubt(
        "lens_contradicts_outline",
        "the sides are bent as by another lens; check k1",
        {"distortion_missing_px": missing, "sigma_distortion_px": 2.0, "farthest_px": 500.0},
    )
    for missing in (20.0, -20.0)
)
CURL = Doubt(
    "slopes_of_no_surface", "curl of 30 times the noise", {"curl_rms_per_m": 3e-3, "curl_expected_rms_per_m": 1e-4}
)
HARMLESS = Doubt("pixels_rejected", "6% of the pixels were rejected")
LENS = "distortion_direction of [camera] is 'measured_to_ideal'"
IMAGES = "the images are mirrored"


def judged(
    monkeypatch: pytest.MonkeyPatch, *doubts: Doubt, explained: tuple[str, ...], refuse: bool = True, turn: float = 7.0
) -> tuple[Doubt, ...]:
    """Judge doubts where the exchanges of these words explain the contradiction."""

    def exchanges(source: Any, setup: Any, mirror: Any, evaluation: Any) -> Iterator[contradictions._Exchange]:
        yield contradictions._Exchange(IMAGES, source, setup)
        yield contradictions._Exchange(LENS, source, setup, is_of_lens=True)

    monkeypatch.setattr(contradictions, "_exchanges", exchanges)
    monkeypatch.setattr(contradictions, "_agrees", lambda one, mirror, choices, curls: one.words in explained)
    monkeypatch.setattr(contradictions, "turn_in_sigmas", lambda evaluation: turn)
    nothing = cast("Any", SimpleNamespace(choices=None, camera=CAMERA))
    return judge_contradictions(nothing, nothing, nothing, nothing, doubts, {}, refuse=refuse)


def test_the_direction_of_the_lens_alone_is_doubted_and_not_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    harmless, found = judged(monkeypatch, HARMLESS, TURNED, explained=(LENS,))
    assert harmless is HARMLESS
    assert (found.code, found.severity) == (TURNED.code, Severity.SERIOUS)
    assert "7 sigma off the outline" in found.text
    assert LENS in found.text
    assert "places of facets" in found.text
    assert "put that right" not in found.text


def test_it_is_believed_where_the_sides_are_bent(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(EstimationError, match=r"once distortion_direction .*put that right"):
        judged(monkeypatch, TURNED, BENT, explained=(LENS,))


def test_sides_bent_another_way_prove_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = judged(monkeypatch, TURNED, BENT_ANOTHER_WAY, explained=(LENS,))
    assert found.severity is Severity.SERIOUS
    assert "put that right" not in found.text


def test_mirrored_images_are_refused_and_the_lens_is_not_named_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(EstimationError, match=r"once the images are mirrored: put that right") as caught:
        judged(monkeypatch, TURNED, explained=(IMAGES, LENS))
    assert 'contradictions = "report"' in str(caught.value)


@pytest.mark.parametrize(
    ("doubts", "turn", "words"),
    [((TURNED,), 25.0, "25 sigma"), ((CURL,), 0.0, "curl of 30 times"), ((TURNED, BENT), 7.0, "put that right")],
)
def test_every_refusal_can_be_overridden(
    doubts: tuple[Doubt, ...], turn: float, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(EstimationError, match=words):
        judged(monkeypatch, *doubts, explained=(LENS,), turn=turn)
    found = judged(monkeypatch, *doubts, explained=(LENS,), refuse=False, turn=turn)
    assert len(found) == len(doubts)
    assert found[0].severity is Severity.SERIOUS
    assert words in found[0].text


def test_what_nothing_explains_stays_a_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    assert judged(monkeypatch, TURNED, HARMLESS, explained=()) == (TURNED, HARMLESS)
    assert judged(monkeypatch, HARMLESS, explained=(IMAGES,)) == (HARMLESS,)
