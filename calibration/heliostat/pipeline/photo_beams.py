"""Rows that name a photo instead of a place: the beam is measured in it and put into the row."""

from pathlib import Path

import numpy as np

from calibration.beam.images import TargetFrame, frame_of_section
from calibration.beam.pipeline import BeamMeasurements, measure_beams
from calibration.heliostat.keys import HeliostatModel
from calibration.heliostat.observations.plant import Plant
from calibration.heliostat.observations.rows import Rows, Verdicts
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, freeze

#: Columns that a photo fills.
_FILLED = ("x_m", "y_m", "sigma_x_mm", "sigma_y_mm")


def with_measured_beams(
    rows: Rows, folder: Path, plant: Plant, model: HeliostatModel
) -> tuple[Rows, BeamMeasurements | None]:
    """Measure the beams in the photos that rows name.

    rows: Rows as they were read; those with a photo and without a place are filled.
    Returns: With places and sigmas [m, mm], or the reason why a photo gave none.
    Returns: What was measured in the photos; None where no row names one that could be looked at.
    InputError: Photos of empty targets, marks or a camera that cannot be used.
    """
    images, kinds, targets = rows.text("image"), rows.text("kind", "beam"), rows.text("target")
    flat, space = rows.vector("x_m", "y_m"), rows.vector("e_m", "n_m", "u_m")
    placed: BoolArray = np.asarray(np.isfinite(flat).all(axis=1) | np.isfinite(space).all(axis=1))
    wanted = np.array(
        [bool(image) and kind == "beam" and not done for image, kind, done in zip(images, kinds, placed, strict=True)],
        dtype=np.bool_,
    )
    if not wanted.any():
        return rows, None
    verdicts = Verdicts(rows)
    frames = beam_frames(folder, plant, model)
    known = np.array([name in frames for name in targets], dtype=np.bool_)
    verdicts.refuse(
        wanted & ~known, "image", lambda row: f"no [[images]] states where target {targets[row]!r} is in its photo"
    )
    files = [folder / name for name in images]
    there = np.array([file.is_file() for file in files], dtype=np.bool_)
    verdicts.refuse(wanted & ~there, "image", lambda row: f"there is no photo {images[row]!r} in {folder}")
    chosen = np.nonzero(wanted & known & there & verdicts.usable)[0].tolist()
    columns = {name: np.array(rows.number(name)) for name in _FILLED}
    beams: BeamMeasurements | None = None
    if chosen:
        beams = measure_beams([files[row] for row in chosen], [targets[row] for row in chosen], frames, jobs=1)
        values = np.column_stack([beams.x_m, beams.y_m, 1e3 * beams.sigma_m])
        for place, row in enumerate(chosen):
            for name, value in zip(_FILLED, values[place], strict=True):
                columns[name][row] = value
            if beams.rejected[place] or not np.isfinite(values[place]).all():
                mask = np.arange(len(rows)) == row
                verdicts.refuse(mask, "image", f"{images[row]}: {beams.reasons[place] or 'no beam found'}")
    numbers = {**rows.numbers, **{name: _frozen(column) for name, column in columns.items()}}
    return Rows(rows.ids, numbers, rows.texts, rows.times, tuple(verdicts.flags), tuple(verdicts.reasons)), beams


def _frozen(column: FloatArray) -> FloatArray:
    return np.asarray(freeze(column))


def beam_frames(folder: Path, plant: Plant, model: HeliostatModel) -> dict[str, TargetFrame]:
    """Return where the targets are in the photos.

    InputError: A target that is not known or described twice, or a file that is not there.
    """
    corners = {one.name: one.corners_m for one in model.target}
    frames: dict[str, TargetFrame] = {}
    for section in model.images:
        name = section.target
        if name not in plant.targets:
            raise InputError(f"images: target {name!r} is not known; there are {', '.join(plant.targets)}")
        if name in frames:
            raise InputError(f"images: target {name!r} is described twice; keep one")
        target = plant.targets[name]
        half = np.array([target.width_m, target.height_m]) / 2
        measured = corners.get(name)
        places = half * [[-1, 1], [1, 1], [1, -1], [-1, -1]]
        if measured is not None:
            places = target.coordinates(np.array(measured))
        frames[name] = frame_of_section(section, places, folder)
    return frames
