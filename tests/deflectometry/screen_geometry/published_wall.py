"""The published wall of dots as a measurement folder."""

import csv
import shutil
from pathlib import Path

import h5py

from heliogauge.measurement.writer import write_measurement


def write_published_wall(data: Path, folder: Path, *photos: int) -> None:
    """Write what is known of the published wall: its camera, and the markers' coordinates, 1 mm each.

    data: The folder `screen_dots` of the published data.
    folder: Where to write; there.
    photos: Which of the five; all by default.
    """
    every = sorted(data.glob("*.JPG"))
    for file in [every[k] for k in photos] if photos else every:
        shutil.copyfile(file, folder / file.name)
    with h5py.File(data / "camera_calibration.h5") as file:
        matrix, lens = file["Camera/intrinsic_mat"][()], file["Camera/distortion_coef"][()]
    with (data / "aruco_corner_locations.csv").open() as text:
        rows = [row for row in csv.reader(text) if not row[0].startswith("#")]
    control = [
        {
            "target": f"{row[0]}.{int(row[1]) - 4 * int(row[0])}",
            "xyz_m": [float(one) for one in row[2:5]],
            "sigma_mm": 1.0,
        }
        for row in rows
    ]
    camera = {
        "name": "camera",
        "width_px": 2160,
        "height_px": 1440,
        "focal_px": matrix[1, 1],
        "aspect": matrix[1, 1] / matrix[0, 0] - 1,
        "center_x_px": matrix[0, 2],
        "center_y_px": matrix[1, 2],
    } | dict(zip(("k1", "k2", "p1", "p2"), lens.tolist(), strict=True))
    content = {
        "kind": "screen-geometry",
        "name": "dot wall",
        "camera": [camera],
        "images": {"photos": "*.JPG"},
        "targets": {"dictionary": "DICT_4X4_1000"},
        "dots": {"dots": "dark", "origin": "light"},
        "shape": {"frame": "network"},
        "control_point": control,
    }
    write_measurement(folder, content)
