"""Rooms: folders that one can survey."""

from collections import Counter
from statistics import median

from tests.architecture.source_tree import all_modules

MOST_MODULES = 20
USUAL_MODULES = 10


def _sizes() -> Counter[str]:
    return Counter(module.room for module in all_modules() if not module.is_face)


def test_a_room_can_be_surveyed() -> None:
    crowded = {room: size for room, size in _sizes().items() if size > MOST_MODULES}
    assert not crowded, f"more than {MOST_MODULES} modules side by side: {crowded}"


def test_most_rooms_are_small() -> None:
    assert median(_sizes().values()) <= USUAL_MODULES


def test_a_room_holds_more_than_one_module() -> None:
    below = Counter(".".join(module.room.split(".")[:-1]) for module in all_modules() if module.is_face)
    lonely = [room for room, size in _sizes().items() if size == 1 and not below[room]]
    assert not lonely, f"a folder with one module is none: {lonely}"
