"""The drone's own positions beside the network."""

import numpy as np

from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.exchange.drone_positions import DronePositions, positions_of_photos, read_positions
from photogrammetry.exchange.position_log import LogClock, read_position_log
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.networks.position_scale import PositionScale, scale_by_positions


def read_drone_positions(measurement: PhotogrammetryMeasurement) -> DronePositions | None:
    """Read where the drone itself says that it was; None where measurement.toml names no positions.

    InputError: Positions that cannot be read.
    """
    section = measurement.model.positions
    if section is None:
        return None
    sigma_m = 1e-3 * section.sigma_mm
    if section.file is None:
        return positions_of_photos(measurement.photo_files, sigma_m)
    path = measurement.folder / section.file
    if section.time_column is not None:
        clock = LogClock(section.time_column, section.time_offset_s, section.time_sigma_s)
        return read_position_log(path, measurement.photo_files, sigma_m, clock)
    return read_positions(path, measurement.photo_files, sigma_m)


def check_positions(measurement: PhotogrammetryMeasurement, bundle: BundleResult) -> PositionScale | None:
    """Compare the size of the flight by the drone's own positions with that by the network.

    Returns: None without positions.
    InputError: Positions that cannot be read.
    EstimationError: Fewer than three photos of the network have one.
    """
    section, found = measurement.model.positions, read_drone_positions(measurement)
    if section is None or found is None:
        return None
    place = {name: k for k, name in enumerate(bundle.problem.observations.photos)}
    rows = np.array([k for k, name in enumerate(found.photos) if name in place], dtype=np.intp)
    photos = np.array([place[found.photos[k]] for k in rows], dtype=np.intp)
    lever_m = 1e-3 * np.array(section.lever_arm_mm)
    return scale_by_positions(bundle, photos, found.enu_m[rows], found.sigma_m[rows], lever_m)
