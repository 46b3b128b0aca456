"""Stage 5: the predicted uncertainty of the beam wherever the sun can stand."""

import numpy as np

from calibration.heliostat.files.result import SkyMap
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.prediction import predict_aim
from calibration.heliostat.observations.plant import Plant
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.validate import freeze

#: Grid of suns [deg]: of thorough runs, and a coarser one of large fields (a quarter of the time).
_AZIMUTHS_DEG = {True: tuple(range(0, 360, 15)), False: tuple(range(0, 360, 30))}
_ELEVATIONS_DEG = {True: tuple(range(10, 90, 10)), False: tuple(range(10, 90, 20))}
#: The sun's largest declination, with its radius [deg].
_LARGEST_DECLINATION_DEG = 23.7


def map_sky(result: HeliostatFit, plant: Plant, inflation: float | None, *, thorough: bool) -> SkyMap | None:
    """Predict the uncertainty over the sky for the first target on which beams were seen.

    inflation: What the residuals of the tried-out split show beyond the noise of the observations.
    thorough: Whether the map is fine.
    Returns: The map; None for a plant without targets.
    """
    targets = plant.targets
    name = next((label for label in result.observations.label if label in targets), next(iter(targets), None))
    if name is None:
        return None
    azimuths_deg, elevations_deg = _AZIMUTHS_DEG[thorough], _ELEVATIONS_DEG[thorough]
    azimuth, elevation = np.meshgrid(np.deg2rad(azimuths_deg), np.deg2rad(elevations_deg))
    latitude = np.deg2rad(plant.origin[0])
    rise = np.sin(latitude) * np.sin(elevation) + np.cos(latitude) * np.cos(elevation) * np.cos(azimuth)
    stands = np.abs(rise) <= np.sin(np.deg2rad(_LARGEST_DECLINATION_DEG))
    sigma, beyond = np.full(azimuth.shape, np.nan), np.zeros(azimuth.shape, dtype=np.bool_)
    if stands.any():
        suns = direction_from_angles(azimuth[stands], elevation[stands])
        predicted = predict_aim(result, suns, targets[name].center_m, inflation=inflation)
        sigma[stands] = predicted.sigma_beam_rad
        beyond[stands] = predicted.extrapolated & predicted.usable
    return SkyMap(name, azimuths_deg, elevations_deg, np.asarray(freeze(sigma)), np.asarray(freeze(beyond)))
