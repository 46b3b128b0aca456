"""What measurement.toml says of a heliostat in its field and of the cameras that look at it."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from deflectometry.keys import CameraSection, KnownPointSection, MirrorSection
from heliogauge.measurement.models import Section, Sigma, Text, Vector3

#: Keys of a mirror before a screen that a heliostat in its field does not have.
_OF_BENCHES = ("pose", "distance", "place", "known_point", "roll_deg", "outline_sigma_mm")


class HeliostatSection(MirrorSection):
    """The heliostat: design and facets as of every mirror, its place, and where its normal points.

    The frame of its mirror: x level and to the right, y up, seen from the front; z along the nominal normal.
    """

    place_m: Vector3 = Field(description="Origin of the mirror's frame: east, north, up in the field's frame [m].")
    sigma_place_mm: Sigma = Field(0.0, description="Standard deviation of each coordinate; 0: exact [mm].")
    aim_m: Vector3 | None = Field(
        None, description="Point that the nominal normal aims the sun at: east, north, up [m]."
    )
    normal: Vector3 | None = Field(
        None, description="Nominal normal, east, north, up, of any length; instead of aim_m where there is no sun."
    )

    @model_validator(mode="after")
    def _in_the_field(self) -> Self:
        for key in _OF_BENCHES:
            if key in self.model_fields_set:
                raise ValueError(f"{key} belongs to a mirror before a screen; leave it out")
        if (self.aim_m is None) == (self.normal is None):
            raise ValueError("give aim_m or normal, one of both")
        if self.normal is not None and not any(self.normal):
            raise ValueError("normal: a direction is needed, not three zeros")
        return self


class FieldCameraSection(Section):
    """A camera with a known place in the field, and points of the mirror that were measured in its images."""

    name: Text = Field(description="Name of the camera, for tables and messages.")
    camera: CameraSection = Field(description="The camera: a file from a calibration, or its parameters.")
    place_m: Vector3 = Field(description="Its centre of projection: east, north, up in the field's frame [m].")
    sigma_place_mm: Sigma = Field(0.0, description="Standard deviation of each coordinate; 0: exact [mm].")
    point: Annotated[tuple[KnownPointSection, ...], Field(min_length=2)] = Field(
        description="Points of the mirror's frame (corners, say) in the images: they orient the camera."
    )
