"""What [plan] of measurement.toml may say for a scan of the surface; measuring does not read it."""

from pydantic import Field, model_validator

from heliogauge.measurement.models import Count, Positive, Section, Vector2


class SurfacePlanSection(Section):
    """What `heliogauge deflectometry plan` expects of mirror and points; measuring does not read it."""

    width_m: Positive = Field(description="Width of the mirror, along its x [m].")
    height_m: Positive = Field(description="Height of the mirror, along its y [m].")
    center_m: Vector2 = Field((0.0, 0.0), description="Its middle in its frame [m].")
    columns: Count = Field(80, description="Points across the mirror.")
    rows: Count = Field(50, description="Points along its height.")
    wave_mrad: Positive | None = Field(
        None,
        description="Slopes that waves of the mirror are expected to have, RMS in one direction, of which patches lose "
        "a part; default: none [mrad].",
    )
    wave_length_m: Positive | None = Field(None, description="Length of these waves [m].")

    @model_validator(mode="after")
    def _waves_have_both(self) -> "SurfacePlanSection":
        if (self.wave_mrad is None) != (self.wave_length_m is None):
            raise ValueError("wave_mrad and wave_length_m are given together or not at all")
        return self
