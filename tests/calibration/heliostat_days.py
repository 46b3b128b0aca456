"""Synthetic observations for the tests of the fit: aimed with the nominal heliostat, reflected by the true one."""

import numpy as np

from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.observations import BeamSpots, Pointings
from heliogauge.geometry.rays import intersect_plane, reflect

TARGET = PlaneTarget.facing("white", [0.0, 0.0, 20.0], 0.0, 8.0, 8.0)


def sun_arc(count, *, declination=0.1, latitude=0.6, hours=8.0):
    """Return directions to the sun over a day, by the hour angle."""
    hour = np.linspace(-hours / 2, hours / 2, count) * np.pi / 12
    south = np.cos(declination) * np.cos(hour) * np.sin(latitude) - np.sin(declination) * np.cos(latitude)
    up = np.cos(declination) * np.cos(hour) * np.cos(latitude) + np.sin(declination) * np.sin(latitude)
    east = -np.cos(declination) * np.sin(hour)
    return np.stack([east, -south, up], axis=1)


def year(count):
    """Return sun directions of three days over the year."""
    parts = [sun_arc(count // 3, declination=angle) for angle in (-0.35, 0.0, 0.35)]
    return np.concatenate(parts)


def beams(design, truth, sun, sigma_m, rng, *, target=TARGET, noise_m=None):
    """Return spots of a heliostat with the numbers ``truth`` that is aimed as the design believes."""
    readings = aim(design, design.parameters.values, sun, target.center_m).readings
    poses = mirror_poses(design, truth, readings)
    rays = reflect(-sun, poses.normals(design))
    along = intersect_plane(poses.centre_m, rays, target.center_m, target.normal)
    xy = target.coordinates(poses.centre_m + along[:, None] * rays)
    xy = xy + rng.normal(0, 1, xy.shape) * (sigma_m if noise_m is None else noise_m)
    return BeamSpots.on_targets(Pointings(readings), sun, {target.name: target}, (target.name,) * len(sun), xy, sigma_m)
