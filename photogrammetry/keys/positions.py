"""Keys of a drone's own positions."""

from pydantic import Field

from heliogauge.measurement.models import Number, Positive, Section, Text


class PositionsSection(Section):
    """Where the drone itself says that it was: checks the size of the network."""

    file: Text | None = Field(
        None,
        description="DJI's .MRK file, or a table: image, latitude_deg, longitude_deg, altitude_m or image, east_m, "
        "north_m, up_m; the camera's yaw_deg, pitch_deg, roll_deg beside them; default: EXIF and XMP of the photos.",
    )
    sigma_mm: Positive = Field(20.0, description="1 sigma of a coordinate where the file or the photos say none [mm].")
    lever_arm_mm: tuple[Number, Number, Number] = Field(
        (0.0, 0.0, 0.0),
        description="From the camera to what is positioned, in the camera's frame: right, down, forward [mm].",
    )
