"""The board that measurement.toml describes."""

from pathlib import Path

import numpy as np

from calibration.camera.boards import Board, CharucoBoard, Chessboard, CircleGrid, TargetField, UnknownField
from calibration.camera.keys import (
    CameraCalibrationMeasurement,
    CharucoSection,
    ChessboardSection,
    CircleGridSection,
    TargetFieldSection,
)
from heliogauge.errors import InputError
from heliogauge.results.folder import read_table_csv
from photogrammetry.targets import RingDictionary, load_dictionary


def described_board(measurement: CameraCalibrationMeasurement) -> Board | UnknownField:
    """Return the board that measurement.toml describes.

    InputError: An impossible board, or a table of targets that cannot be read.
    """
    section = measurement.model.board
    if isinstance(section, ChessboardSection):
        return Chessboard(section.columns, section.rows, _in_metres(section.square_mm))
    if isinstance(section, CharucoSection):
        share = section.marker_mm / section.square_mm
        return CharucoBoard(section.columns, section.rows, section.dictionary, share, _in_metres(section.square_mm))
    if isinstance(section, CircleGridSection):
        share = 0.5 if section.diameter_mm is None or not section.pitch_mm else section.diameter_mm / section.pitch_mm
        asymmetric = section.type == "circles-asymmetric"
        return CircleGrid(section.columns, section.rows, asymmetric, _in_metres(section.pitch_mm), share)
    if section.file is None:
        return UnknownField(section.dictionary)
    return _target_field(section, measurement.folder / section.file)


def known_codes(measurement: CameraCalibrationMeasurement) -> RingDictionary | None:
    """Return the codes of the board's targets: a vendor's, or those of a file beside measurement.toml.

    Returns: The dictionary; None for boards without ring codes.
    InputError: No such dictionary, or a file with faults.
    """
    section = measurement.model.board
    return load_dictionary(section.dictionary, measurement.folder) if isinstance(section, TargetFieldSection) else None


def _in_metres(value_mm: float | None) -> float | None:
    return None if value_mm is None else 1e-3 * value_mm


def _target_field(section: TargetFieldSection, path: Path) -> TargetField:
    columns = read_table_csv(path, ("id", "x_m", "y_m"))
    z = columns.get("z_m", ["0"] * len(columns["id"]))
    try:
        places = np.array([columns["x_m"], columns["y_m"], z], dtype=np.float64).T
    except ValueError as error:
        raise InputError(f"{path}: x_m, y_m and z_m must hold numbers ({error})") from error
    return TargetField(section.dictionary, tuple(columns["id"]), places)
