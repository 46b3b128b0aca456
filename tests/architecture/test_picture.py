"""The picture of the rooms shows the code as it is."""

import importlib.util

import pytest

from tests.architecture.source_tree import REPOSITORY


def test_the_picture_of_the_rooms_is_true() -> None:
    spec = importlib.util.spec_from_file_location("draw_rooms", REPOSITORY / "docs" / "draw_rooms.py")
    assert spec is not None
    assert spec.loader is not None
    drawing = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(drawing)
    if drawing.PICTURE.read_text(encoding="utf-8") != drawing.draw():
        pytest.fail("rooms or their imports have changed: python docs/draw_rooms.py, and look at ARCHITECTURE.md")
