"""Keys of a drone's own positions."""

from pydantic import Field

from heliogauge.measurement.models import Number, Positive, Section, Sigma, Text


class PositionsSection(Section):
    """Where the drone itself says that it was: checks the size of the network."""

    file: Text | None = Field(
        None,
        description="DJI's .MRK file, or a table: image, latitude_deg, longitude_deg, altitude_m or image, east_m, "
        "north_m, up_m; the camera's yaw_deg, pitch_deg, roll_deg beside them; default: EXIF and XMP of the photos.",
    )
    time_column: str | None = Field(
        None,
        max_length=200,
        description="Column of times in the table, instead of image: 2026-05-04 10:31:07; compared with EXIF.",
    )
    time_offset_s: Number = Field(0.0, description="Clock of the camera less that of the table [s].")
    time_sigma_s: Sigma = Field(0.0, description="Its error, 1 sigma [s].")
    sigma_mm: Positive = Field(20.0, description="1 sigma of a coordinate where the file or the photos say none [mm].")
    lever_arm_mm: tuple[Number, Number, Number] = Field(
        (0.0, 0.0, 0.0),
        description="From the camera to what is positioned, in the camera's frame: right, down, forward [mm].",
    )
