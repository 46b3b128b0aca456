"""Heliostats as chains of drives, shifts and turns.

Usual kinds by name; forward from the readings to the pose of the mirror, back from an aim point to the readings;
derivatives for all parameters.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.kinematic_model.aiming import aim as aim
    from calibration.heliostat.kinematic_model.design import HeliostatDesign as HeliostatDesign
    from calibration.heliostat.kinematic_model.design import PlaneTarget as PlaneTarget
    from calibration.heliostat.kinematic_model.kinematics import mirror_poses as mirror_poses
    from calibration.heliostat.kinematic_model.kinematics import pose_derivatives as pose_derivatives
    from calibration.heliostat.kinematic_model.presets import ActuatorNumbers as ActuatorNumbers
    from calibration.heliostat.kinematic_model.presets import azimuth_elevation as azimuth_elevation
    from calibration.heliostat.kinematic_model.presets import drone_heliostat as drone_heliostat
    from calibration.heliostat.kinematic_model.presets import linear_actuators as linear_actuators
    from calibration.heliostat.kinematic_model.presets import with_drive_terms as with_drive_terms

__getattr__, __dir__, __all__ = lazy_face(__name__)
