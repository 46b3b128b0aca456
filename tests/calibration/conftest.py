"""Photos of boards that several tests measure, drawn once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from data_synth.targets.boards import board_scene, board_table
from data_synth.targets.dataset import PhotoOptions, camera_content, write_target_dataset

#: Photos and pixels per pixel of the preset's camera: as few as determine the camera well.
_SIZES = {
    "chessboard": (8, 0.6),
    "chessboard-symmetric": (6, 0.45),
    "charuco": (6, 0.6),
    "circles-asymmetric": (6, 0.6),
    "targets": (5, 0.6),
}


@pytest.fixture(scope="session")
def board_photos(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return the folder with photos of a bent board of the given kind; copy it before changing it."""
    drawn: dict[str, Path] = {}

    def folder(kind: str) -> Path:
        if kind not in drawn:
            photos, scale = _SIZES[kind]
            scene = board_scene(kind, 3, n_photos=photos).scaled(scale)
            drawn[kind] = tmp_path_factory.mktemp(kind) / "photos"
            write_target_dataset(drawn[kind], scene, camera_content(scene, board_table(kind)), PhotoOptions(3))
        return drawn[kind]

    return folder
