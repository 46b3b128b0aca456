"""What all heliostats of a field share: where the plant is, and its targets."""

from dataclasses import dataclass
from math import degrees

import numpy as np

from calibration.heliostat.kinematic_model.design import PlaneTarget
from heliogauge.errors import InputError
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.geometry.sun import Site
from heliogauge.validate import FloatArray

#: A heliostat this far from its plant is another plant's: the last rows of the largest stand 1.6 km from their tower,
#: and a beam of 10 km is 93 m wide by the sun's size alone [m].
_FARTHEST_M = 10_000.0


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """What all heliostats of a field share.

    origin: Latitude [deg], longitude [deg], altitude [m] of the field's frame.
    site: Where the sun is observed from, with the air above.
    targets: Targets by name.
    other_targets: Names of targets that are not flat: beams on them cannot be used.
    """

    origin: tuple[float, float, float]
    site: Site
    targets: dict[str, PlaneTarget]
    other_targets: tuple[str, ...] = ()

    def place_of(self, latitude_deg: float, longitude_deg: float, altitude_m: float, what: str) -> FloatArray:
        """Return where a heliostat stands in the field's frame, shape (3,) [m].

        what: What it is called in a message.
        InputError: Far from the plant; with the sign, the order or the unit that would bring it there.
        """
        place = enu_from_geodetic(latitude_deg, longitude_deg, altitude_m, self.origin)
        away = float(np.linalg.norm(place))
        if away < _FARTHEST_M:
            return place
        others = {
            "with the latitude's sign turned": (-latitude_deg, longitude_deg),
            "with the longitude's sign turned": (latitude_deg, -longitude_deg),
            "with both signs turned": (-latitude_deg, -longitude_deg),
            "with latitude and longitude exchanged": (longitude_deg, latitude_deg),
            "taken for radians": (degrees(latitude_deg), degrees(longitude_deg)),
        }
        distances = {
            text: float(np.linalg.norm(enu_from_geodetic(*one, altitude_m, self.origin)))
            for text, one in others.items()
            if abs(one[0]) <= 90
        }
        nearest = min(distances, key=lambda text: distances[text])
        said = f"{what}: it stands {1e-3 * away:.0f} km from the plant at {self.origin[0]:g}, {self.origin[1]:g} deg"
        if distances[nearest] < _FARTHEST_M:
            raise InputError(f"{said}; {nearest} it would stand {1e-3 * distances[nearest]:.2f} km from it")
        raise InputError(f"{said}; nor is it near {', '.join(distances)}")
