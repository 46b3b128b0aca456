"""The uncertainty of the beam at any sun, from the map over the sky that a calibration keeps."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from heliogauge.geometry.sun import angles_from_direction, direction_from_angles
from heliogauge.validate import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SkyForecast:
    """Predicted uncertainty of the beam over the sky.

    azimuths_deg (k,), elevations_deg (m,): The map's suns, evenly spaced; azimuths all around [deg].
    sigma_beam_rad (m, k): Root of both axes' variances; NaN where the sun never stands or no drive can follow [rad].
    extrapolated (m, k): Whether the sun stands beyond those that were used.
    """

    azimuths_deg: FloatArray
    elevations_deg: FloatArray
    sigma_beam_rad: FloatArray
    extrapolated: BoolArray

    @classmethod
    def from_content(cls, sky: Mapping[str, Any]) -> "SkyForecast":
        """Take the map from ``sky`` of ``heliostat.json``."""
        sigma = np.array([[np.nan if one is None else one for one in row] for row in sky["sigma_beam_mrad"]])
        return cls(
            np.array(sky["azimuth_deg"], dtype=np.float64),
            np.array(sky["elevation_deg"], dtype=np.float64),
            1e-3 * sigma,
            np.array(sky["extrapolated"], dtype=np.bool_),
        )

    def at(self, suns: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Interpolate between the suns of the map.

        Shapes: suns (n, 3).
        Returns (n,): Sigma of the beam [rad], NaN if the map is empty, and whether the nearest known sun of the map
            is an extrapolation.

        Linear in variance over azimuth and elevation between four suns; at the edge of what the map knows the largest
        of those that it has, or the nearest one. Its lowest and highest elevation hold beyond them.
        """
        azimuth, elevation = (np.rad2deg(angle) for angle in angles_from_direction(suns))
        across = np.mod(azimuth - self.azimuths_deg[0], 360.0) / (self.azimuths_deg[1] - self.azimuths_deg[0])
        along = (elevation - self.elevations_deg[0]) / (self.elevations_deg[1] - self.elevations_deg[0])
        along = np.clip(along, 0.0, len(self.elevations_deg) - 1.0)
        left, low = np.floor(across).astype(np.intp), np.minimum(along.astype(np.intp), len(self.elevations_deg) - 2)
        corners, shares = [], []
        for row in (0, 1):
            for column in (0, 1):
                corners.append(self.sigma_beam_rad[low + row, (left + column) % len(self.azimuths_deg)])
                shares.append(np.abs(1 - row - (along - low)) * np.abs(1 - column - (across - left)))
        # A corner without a share, beside a sun that stands on a line of the map, does not count.
        weights = np.where(np.stack(shares) > 1e-9, np.stack(shares), 0.0)
        variances = np.where(weights > 0, np.stack(corners) ** 2, 0.0)
        sigma = np.sqrt(np.sum(variances * weights, axis=0))
        nearest, beyond = self._nearest(suns)
        largest = np.sqrt(np.max(np.nan_to_num(variances, nan=-1.0), axis=0, initial=0.0))
        edge = np.where(largest > 0, largest, nearest)
        return np.where(np.isfinite(sigma), sigma, edge), beyond

    def _nearest(self, suns: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return sigma and whether it is extrapolated at the nearest sun of the map that has one."""
        place = np.argwhere(np.isfinite(self.sigma_beam_rad))
        if not len(place):
            return np.full(len(suns), np.nan), np.zeros(len(suns), dtype=np.bool_)
        known = direction_from_angles(
            np.deg2rad(self.azimuths_deg[place[:, 1]]), np.deg2rad(self.elevations_deg[place[:, 0]])
        )
        row, column = place[np.argmax(suns @ known.T, axis=1)].T
        return np.asarray(self.sigma_beam_rad[row, column]), np.asarray(self.extrapolated[row, column])
