"""Pictures of beams for the reports: the most informative photos, put on their targets' planes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.beam.images import TargetFinder
from calibration.beam.pipeline import write_beams
from calibration.heliostat.files.beam_files import BEAMS_FILE, PICTURE_COLUMNS, PICTURES_FILE
from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.store_residuals import residual_columns
from calibration.heliostat.pipeline.photo_beams import beam_frames
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.tables import write_table_csv
from heliogauge.results.thumbnails import write_thumbnails
from heliogauge.validate import BoolArray, FloatArray

#: Of each heliostat at most so many pictures, about 15 kB each: left out, largest residuals, around the median.
MOST_REFUSED, MOST_WORST, MOST_TYPICAL = 4, 5, 3


def write_beam_files(result: HeliostatResult, shared: Shared, folder: Path, *, pictures: bool = True) -> None:
    """Write the beams of a heliostat whose rows name photos, with pictures of some; nothing without photos.

    ``beams.csv`` has all beams. ``photos/beam_NN.jpg`` are photos put on the target's plane; ``beam_pictures.csv`` says
    which observation each shows, why it was chosen, and where its edges are on the target.

    shared: What all heliostats of the run share.
    pictures: Whether pictures are made, 0.2 s each.
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
    frames = beam_frames(shared.folder, shared.plant, shared.model)
    finders: dict[str, TargetFinder] = {}
    thumbnails: dict[str, bytes] = {}
    rows: list[tuple[str, ...]] = []
    for row, why in informative_rows(residual, list(columns["flag"]), seen):
        target = str(columns["target"][row])
        if target not in finders:
            finders[target] = TargetFinder(frames[target])
        try:
            image = finders[target].image(photos[row])
        except (EstimationError, InputError):
            # Of a photo without the target there is nothing to show; its row has the reason.
            continue
        height, width = image.values_dn.shape
        (left, low), (right, high) = image.points_m([[-0.5, height - 0.5], [width - 0.5, -0.5]]).tolist()
        name = f"beam_{len(rows) + 1:02d}"
        darkest = float(np.nanmin(image.values_dn)) if np.isfinite(image.values_dn).any() else 0.0
        thumbnails[name] = make_thumbnail(np.nan_to_num(image.values_dn, nan=darkest).astype(np.float32))
        edges = (f"{edge:.6g}" for edge in (left, right, low, high))
        rows.append((name, str(columns["observation"][row]), photos[row].name, why, *edges, str(width), str(height)))
    write_thumbnails(folder, thumbnails)
    if rows:
        write_table_csv(
            folder / PICTURES_FILE, dict(zip(PICTURE_COLUMNS, map(list, zip(*rows, strict=True)), strict=True))
        )


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
