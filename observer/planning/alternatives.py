"""What other flights than the planned one would give: more and fewer photos, two passes, photos from the side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.planning.planned_flight import Pass
from observer.planning.simulated_flight import Simulated

#: The name of the flight that all others are compared with.
AS_PLANNED = "as planned"
#: Two passes stand so many quarters of the trough's length beside the one that they replace.
_ASIDE = 1.0
#: Photos from the side: as many, and the last ones so far aside as seen from the vertex [rad].
_SIDE_PHOTOS, _SIDE_RAD = 10, np.radians(35.0)


@dataclass(frozen=True, slots=True)
class Alternative:
    """What a flight would give.

    name: How it differs from the planned one.
    photos: Their number.
    sigma_theta_r_rad: Median sigma of theta_r [rad].
    sigma_without_tilt_rad: The same without the mean tilt of the map [rad].
    sigma_random_rad: Median of what differs from point to point, of dz/dx [rad].
    measured_share: Share of the mirror that is measured.
    sigma_absorber_x_m, sigma_absorber_z_m: RMS along the tube [m].
    """

    name: str
    photos: int
    sigma_theta_r_rad: float
    sigma_without_tilt_rad: float
    sigma_random_rad: float
    measured_share: float
    sigma_absorber_x_m: float
    sigma_absorber_z_m: float

    @classmethod
    def of(cls, name: str, photos: int, simulated: Simulated) -> "Alternative":
        """Return the numbers of a simulated measurement.

        EstimationError: It measures nothing of the mirror.
        """
        slope_map, path = simulated.slope_map, simulated.absorber
        valid = slope_map.valid
        if not valid.any():
            raise EstimationError(f"plan: {name}: nothing of the mirror would be measured")
        across, up = path.sigma_at(path.y_m)
        return cls(
            name,
            photos,
            float(np.median(theta_r_sigmas(slope_map))),
            float(np.median(theta_r_sigmas(slope_map, with_tilt=False))),
            float(np.median(slope_map.sigma_random_x[valid])),
            slope_map.measured_share,
            float(np.sqrt(np.mean(across**2))),
            float(np.sqrt(np.mean(up**2))),
        )


def theta_r_sigmas(slope_map: SlopeMap, *, with_tilt: bool = True) -> FloatArray:
    """Return the sigma of theta_r at the measured nodes of a map, shape (n,) [rad].

    with_tilt: Whether the mean of all nodes counts; errors of slopes are usually compared without it.
    """
    valid = slope_map.valid
    x, y = (grid[valid] for grid in np.meshgrid(slope_map.x_m, slope_map.y_m))
    turned = 1 + slope_map.slope_x[valid] ** 2
    common = slope_map.common.evaluate(x, y)[:, 0] / turned
    if not with_tilt:
        common = common - common.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt((slope_map.sigma_random_x[valid] / turned) ** 2 + (common**2).sum(axis=0)))


def other_flights(passes: Sequence[Pass], length_m: float) -> dict[str, tuple[Pass, ...]]:
    """Return flights to compare with the planned one.

    length_m: Of the collector [m].
    """

    def times(share: float) -> tuple[Pass, ...]:
        return tuple(replace(one, photos=max(2, round(share * one.photos))) for one in passes)

    aside = _ASIDE * length_m / 4
    apart = tuple(replace(one, y_m=one.y_m + way * aside) for way in (-1.0, 1.0) for one in times(0.5))
    first = passes[0]
    from_sides = replace(first, reach_m=first.height_m * float(np.tan(_SIDE_RAD)), photos=_SIDE_PHOTOS)
    return {
        "half as many photos": times(0.5),
        "twice as many photos": times(2.0),
        f"the same photos in two passes {2 * aside:.2g} m apart": apart,
        f"and {_SIDE_PHOTOS} photos up to {np.degrees(_SIDE_RAD):.0f} degrees aside": (*passes, from_sides),
    }
