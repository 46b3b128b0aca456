"""Photographs of a calibration board, which is never flat nor square."""

from dataclasses import replace

import numpy as np

from data_synth.optics.markers import charuco_print, chessboard_print
from data_synth.optics.photo import View
from data_synth.optics.prints import DotGridPrint, Print, RingPrint
from data_synth.optics.sheets import Sheet, SheetShape
from data_synth.targets.presets import SMALL_CAMERA, look_at
from data_synth.targets.scene import Conditions, TargetScene
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.validate import FloatArray
from photogrammetry.targets import ring_dictionary

#: A laser print: 0.1 % longer than drawn along the paper's way, 0.3 mrad out of square.
PRINTER = np.array([[1.0, 3e-4], [0.0, 1.001]])
#: Bent by 1 mm over half of a board 0.3 m wide, twisted, with a bulge.
BENDING_PER_M = np.array([0.045, 0.02, -0.03])
RIPPLE_PER_M2 = np.array([0.1, -0.08])

_BOARDS = ("chessboard", "charuco", "circles", "circles-asymmetric", "targets")
#: Columns and rows of the plate with targets, and their distance.
_PLATE = (9, 6)
_PLATE_PITCH_M = 0.033
#: Half turned, this one looks as before; for checks only.
_SYMMETRIC = "chessboard-symmetric"


def board_figure(kind: str) -> Print:
    """Return a calibration board of about 0.3 m by 0.2 m.

    kind: ``chessboard``, ``chessboard-symmetric``, ``charuco``, ``circles`` or ``circles-asymmetric``.
    InputError: No such board.
    """
    if kind == "chessboard":
        return chessboard_print(10, 7, 0.03)
    if kind == _SYMMETRIC:
        return chessboard_print(10, 8, 0.03)
    if kind == "charuco":
        return charuco_print(10, 7, 0.03, 0.022, "DICT_5X5_100")
    if kind == "circles":
        return DotGridPrint(10, 7, 0.03, 0.015)
    if kind == "circles-asymmetric":
        return DotGridPrint(4, 11, 0.04, 0.013, asymmetric=True)
    raise InputError(f"board {kind!r}: one of {', '.join(_BOARDS)} is needed")


def board_table(kind: str) -> dict[str, object]:
    """Return how measurement.toml describes the board."""
    tables: dict[str, dict[str, object]] = {
        "chessboard": {"type": "chessboard", "columns": 9, "rows": 6, "square_mm": 30.0},
        _SYMMETRIC: {"type": "chessboard", "columns": 9, "rows": 7, "square_mm": 30.0},
        "targets": {"type": "targets", "dictionary": "aicon-12"},
        "charuco": {
            "type": "charuco",
            "columns": 10,
            "rows": 7,
            "square_mm": 30.0,
            "marker_mm": 22.0,
            "dictionary": "DICT_5X5_100",
        },
        "circles": {"type": "circles", "columns": 10, "rows": 7, "pitch_mm": 30.0, "diameter_mm": 15.0},
        "circles-asymmetric": {
            "type": "circles-asymmetric",
            "columns": 4,
            "rows": 11,
            "pitch_mm": 40.0,
            "diameter_mm": 13.0,
        },
    }
    return tables[kind]


def board_scene(kind: str, seed: int = 0, *, n_photos: int = 12, flat: bool = False) -> TargetScene:
    """Return photos of a board from all sides: tilted, rolled, at several distances, in all parts of the image.

    kind: The board, as for `board_figure`, or ``targets``.
    seed: Poses are drawn with it.
    flat: A flat and true print instead of a bent and sheared one.
    Returns: The scene; the world is the board's frame.
    InputError: No such board.
    """
    rng = np.random.default_rng(seed)
    shape = SheetShape() if flat else SheetShape(PRINTER, BENDING_PER_M, RIPPLE_PER_M2)
    if kind == "targets":
        return _target_plate(shape, n_photos, rng)
    board = Sheet("", board_figure(kind), RigidTransform.identity(), shape=shape)
    views = tuple(_board_view(k, n_photos, rng) for k in range(n_photos))
    conditions = Conditions(blur_sigma_px=0.6, ground=0.25)
    return TargetScene(f"{kind} board", (board,), views, conditions)


def _target_plate(shape: SheetShape, n_photos: int, rng: np.random.Generator) -> TargetScene:
    """Place ring-coded targets on a bent plate, every fifth on a block 40 mm high."""
    codes = ring_dictionary("aicon-12").codes
    sheets = []
    for k in range(_PLATE[0] * _PLATE[1]):
        row, column = divmod(k, _PLATE[0])
        place = np.array([column - 0.5 * (_PLATE[0] - 1), row - 0.5 * (_PLATE[1] - 1)]) * _PLATE_PITCH_M
        at = shape.points_m(place) + np.array([0.0, 0.0, 0.04 if k % 5 == 2 else 0.0])
        turn = rotation_from_vector(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
        code = codes[k]
        sheets.append(Sheet(code.name, RingPrint(code, 0.007), RigidTransform(turn, at)))
    views = tuple(_board_view(k, n_photos, rng) for k in range(n_photos))
    conditions = Conditions(blur_sigma_px=0.6, ground=0.25)
    return TargetScene("plate with targets", tuple(sheets), views, conditions, dictionary="aicon-12")


def _board_view(k: int, n_photos: int, rng: np.random.Generator) -> View:
    tilt = np.radians((10, 35, 42, 30)[k % 4] + rng.uniform(-5, 5))
    azimuth = 2 * np.pi * k / n_photos * 5 + rng.uniform(-0.3, 0.3)
    distance = (0.47, 0.54, 0.66)[k % 3] * rng.uniform(0.95, 1.05)
    direction = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    roll = (np.pi / 2) * (0, 1, 2, 3)[k % 4] + rng.uniform(-0.2, 0.2)
    pose = look_at(direction * distance, np.zeros(3), roll)
    # Shift the board towards a corner or an edge of the image, so that all of it is covered.
    share = np.array([(-0.14, 0.17, 0.02)[(k + k // 3) % 3], (-0.07, 0.1, 0.0)[(k // 3) % 3]])
    return replace(View(f"photo_{k + 1:03d}", SMALL_CAMERA, pose), cam_from_world=_shifted(pose, share * distance))


def _shifted(pose: RigidTransform, shift_m: FloatArray) -> RigidTransform:
    return RigidTransform(pose.rotation, pose.translation_m + np.array([*shift_m, 0.0]))
