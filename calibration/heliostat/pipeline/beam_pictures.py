"""Pictures of beams for the reports: the most informative photos, drawn with measured and expected places."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.heliostat.beam_photos import BeamPainter, write_beams
from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.store_residuals import residual_columns
from calibration.heliostat.pipeline.photo_beams import beam_frames
from heliogauge.validate import BoolArray, FloatArray

BEAMS_FILE = "beams.csv"
#: Of each heliostat at most so many pictures, about 70 kB each: left out, largest residuals, around the median.
MOST_REFUSED, MOST_WORST, MOST_TYPICAL = 4, 5, 3


def write_beam_files(result: HeliostatResult, shared: Shared, folder: Path, *, pictures: bool = True) -> None:
    """Write ``beams.csv`` and pictures ``beam_NN.png`` of a heliostat whose rows name photos; nothing without photos.

    shared: What all heliostats of the run share.
    pictures: Whether pictures are drawn, 0.3 s each.
    InputError: A file cannot be written, or the measurement's photos have changed since.
    """
    if result.beams is None:
        return
    write_beams(folder / BEAMS_FILE, result.beams)
    if not pictures:
        return
    columns = residual_columns(result, shared)
    measured = set(result.beams.files)
    photos = [shared.folder / name for name in columns["image"]]
    seen = np.array([photo in measured for photo in photos], dtype=np.bool_)
    residual = np.asarray(columns["residual_beam_mrad"], dtype=np.float64)
    painter = BeamPainter(beam_frames(shared.folder, shared.plant, shared.model))
    for number, (row, why) in enumerate(informative_rows(residual, list(columns["flag"]), seen), start=1):
        photo, target = photos[row], str(columns["target"][row])
        predicted = np.array([columns["predicted_x_m"][row], columns["predicted_y_m"][row]])
        # Of a photo without the target there is nothing to draw; its row has the reason.
        content = painter.png(photo, target, predicted, title=f"{photo.name}: {why}")
        if content is not None:
            (folder / f"beam_{number:02d}.png").write_bytes(content)


def informative_rows(residual_mrad: FloatArray, flags: Sequence[str], seen: BoolArray) -> list[tuple[int, str]]:
    """Choose the most informative photos.

    residual_mrad (n,): Residual of the beam; NaN where there is none [mrad].
    flags length n: Why a row was left out; empty for those that were used.
    seen (n,): Rows whose beam was measured in a photo.
    Returns: Rows and why they were chosen, each row once: some that were left out, the largest residuals, the
        median.
    """
    left_out = np.array([flag != "" for flag in flags], dtype=np.bool_)
    chosen = [(int(row), f"left out ({flags[row]})") for row in np.nonzero(seen & left_out)[0][:MOST_REFUSED]]
    used = np.nonzero(seen & ~left_out & np.isfinite(residual_mrad))[0]
    used = used[np.argsort(-residual_mrad[used], kind="stable")]
    typical = used[max(len(used) // 2 - MOST_TYPICAL // 2, 0) :][:MOST_TYPICAL]
    worst = [row for row in used if row not in typical][:MOST_WORST]
    chosen += [(int(row), f"among the worst, {residual_mrad[row]:.2f} mrad") for row in worst]
    return chosen + [(int(row), f"typical, {residual_mrad[row]:.2f} mrad") for row in typical]
