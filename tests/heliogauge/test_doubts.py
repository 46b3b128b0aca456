"""Doubts: values that can be compared, sent to another process, and put together once each."""

import pickle

from heliogauge.doubts import Doubt, Severity, gather_doubts, heaviest_first


def test_doubts_are_values() -> None:
    first = Doubt("photos_few", "3 photos", {"photos_count": 3})
    again = Doubt("photos_few", "3 photos", {"photos_count": 3.0})
    other = Doubt("photos_few", "3 photos", {"photos_count": 4})
    assert first == again
    assert hash(first) == hash(again)
    assert first != other
    assert pickle.loads(pickle.dumps(first)) == first


def test_the_heaviest_doubt_stands_first_and_keeps_its_number() -> None:
    weights = (Severity.NOTE, Severity.DOUBT, Severity.SERIOUS, Severity.DOUBT)
    doubts = [Doubt(f"d{k}", "", severity=one) for k, one in enumerate(weights, start=1)]
    assert [(number, one.code) for number, one in heaviest_first(doubts)] == [
        (3, "d3"),
        (2, "d2"),
        (4, "d4"),
        (1, "d1"),
    ]


def test_gathered_doubts_keep_order_and_each_once() -> None:
    one, two = Doubt("one", "1"), Doubt("two", "2", severity=Severity.SERIOUS)
    assert gather_doubts(None, two, [one, two], (), one) == (two, one)
