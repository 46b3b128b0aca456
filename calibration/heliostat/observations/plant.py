"""What all heliostats of a field share: where the plant is, and its targets."""

from dataclasses import dataclass

from calibration.heliostat.kinematic_model.design import PlaneTarget
from heliogauge.geometry.sun import Site


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
