"""Tables of a result: image points, lengths, intrinsics, covariances."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from heliogauge.camera.millimetres import SENSOR_NAMES, Sensor, sensor_parameters
from heliogauge.camera.model import Camera
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.statistics import examine_image_points, examine_intrinsics
from photogrammetry.networks.length_error import LengthStatement
from photogrammetry.networks.quality import bar_checks
from photogrammetry.start_values.network import ImagePlace


def covariance_columns(bundle: BundleResult) -> dict[str, Any]:
    """Return the covariance of the coordinates of each target."""
    covariance = bundle.covariance.points
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    columns: dict[str, Any] = {"id": list(bundle.problem.observations.targets)}
    return columns | {f"{name}_m2": covariance[:, i, j] for name, (i, j) in names.items()}


def residual_columns(bundle: BundleResult) -> dict[str, Any]:
    """Return the image points with residuals, redundancy and test."""
    table, tests = bundle.problem.observations, examine_image_points(bundle)
    sigma = np.sqrt(np.einsum("mii->mi", table.covariance_px2))
    return {
        "image": [table.photos[i] for i in table.photo_index.tolist()],
        "target": [table.targets[i] for i in table.target_index.tolist()],
        "x_px": table.pixels_px[:, 0],
        "y_px": table.pixels_px[:, 1],
        "sigma_x_px": sigma[:, 0],
        "sigma_y_px": sigma[:, 1],
        "residual_x_px": bundle.residuals_px[:, 0],
        "residual_y_px": bundle.residuals_px[:, 1],
        "redundancy_x": tests.redundancy[:, 0, 0],
        "redundancy_y": tests.redundancy[:, 1, 1],
        "test": np.sqrt(tests.length_squared),
    }


def place_columns(places: Sequence[ImagePlace | None]) -> dict[str, Any]:
    """Return places in photos; empty cells for what is not at one place."""
    return {
        "image": ["" if one is None else one.photo for one in places],
        "x_px": [np.nan if one is None else one.x_px for one in places],
        "y_px": [np.nan if one is None else one.y_px for one in places],
    }


def constraint_columns(bundle: BundleResult, kept_apart: tuple[Distance, ...]) -> dict[str, Any]:
    """Return the known lengths, used and kept apart, beside what the network has."""
    checked = bar_checks(bundle, kept_apart)
    return {
        "name": [one.name for one in checked],
        "target_a": [one.targets[0] for one in checked],
        "target_b": [one.targets[1] for one in checked],
        "used": [int(one.used) for one in checked],
        "known_m": [one.known_m for one in checked],
        "sigma_known_m": [one.sigma_known_m for one in checked],
        "measured_m": [one.measured_m for one in checked],
        "sigma_measured_m": [one.sigma_measured_m for one in checked],
        "error_m": [one.measured_m - one.known_m for one in checked],
    }


def length_columns(lengths: LengthStatement) -> dict[str, Any]:
    """Return the length errors of lines whose length the network did not use."""
    names = [
        "name",
        "role",
        "line",
        "known_m",
        "sigma_known_m",
        "measured_m",
        "sigma_measured_m",
        "error_m",
        "sigma_error_m",
        "permissible_m",
        "verdict",
    ]
    columns = {name: [getattr(one, name) for one in lengths.checks] for name in names}
    return columns | {"permissible_m": [v if np.isfinite(v) else np.nan for v in columns["permissible_m"]]}


def intrinsic_columns(bundle: BundleResult) -> dict[str, Any]:
    """Return the intrinsics with sigma, significance and strongest correlation."""
    tests = examine_intrinsics(bundle)
    names = ("camera", "name", "value", "sigma", "significance", "rival", "correlation")
    return {name: [getattr(one, name) for one in tests] for name in names}


def millimetre_columns(cameras: Mapping[str, Camera], sensors: Mapping[str, Sensor]) -> dict[str, Any]:
    """Return the cameras that were given in millimetres, in the same form."""
    columns: dict[str, list[Any]] = {"camera": [], "name": [], "value": [], "sigma": []}
    for camera, sensor in sensors.items():
        found = sensor_parameters(cameras[camera], sensor)
        columns["camera"] += [camera] * len(found.values)
        columns["name"] += SENSOR_NAMES[sensor.form]
        columns["value"] += found.values.tolist()
        columns["sigma"] += found.sigma.tolist()
    return columns
