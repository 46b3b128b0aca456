"""Stage 5: the predicted uncertainty of the beam wherever the sun can stand."""

import numpy as np

from calibration.heliostat.files.result import SkyMap
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.prediction import predict_aim
from calibration.heliostat.observations.plant import Plant
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.validate import freeze

#: Grid of suns [deg].
_AZIMUTHS_DEG = tuple(range(0, 360, 15))
_ELEVATIONS_DEG = tuple(range(10, 90, 10))
#: The sun's largest declination, with its radius [deg].
_LARGEST_DECLINATION_DEG = 23.7


def map_sky(result: HeliostatFit, plant: Plant) -> SkyMap | None:
    """Predict the uncertainty over the sky for the first target on which beams were seen.

    Returns: The map; None for a plant without targets.
    """
    targets = plant.targets
    name = next((label for label in result.observations.label if label in targets), next(iter(targets), None))
    if name is None:
        return None
    azimuth, elevation = np.meshgrid(np.deg2rad(_AZIMUTHS_DEG), np.deg2rad(_ELEVATIONS_DEG))
    latitude = np.deg2rad(plant.origin[0])
    rise = np.sin(latitude) * np.sin(elevation) + np.cos(latitude) * np.cos(elevation) * np.cos(azimuth)
    stands = np.abs(rise) <= np.sin(np.deg2rad(_LARGEST_DECLINATION_DEG))
    sigma, beyond = np.full(azimuth.shape, np.nan), np.zeros(azimuth.shape, dtype=np.bool_)
    if stands.any():
        suns = direction_from_angles(azimuth[stands], elevation[stands])
        predicted = predict_aim(result, suns, targets[name].center_m)
        sigma[stands] = predicted.sigma_beam_rad
        beyond[stands] = predicted.extrapolated & predicted.usable
    return SkyMap(name, _AZIMUTHS_DEG, _ELEVATIONS_DEG, np.asarray(freeze(sigma)), np.asarray(freeze(beyond)))
