"""What [plan] of measurement.toml may say for a laser scan; measuring does not read it."""

from pydantic import Field

from heliogauge.measurement.models import Count, Positive, Section, Vector2


class LaserPlanSection(Section):
    """What `heliogauge deflectometry plan` expects of mirror, beams and target; measuring does not read it."""

    width_m: Positive = Field(description="Width of the mirror, along its x [m].")
    height_m: Positive = Field(description="Height of the mirror, along its y [m].")
    center_m: Vector2 = Field((0.0, 0.0), description="Its middle in its frame [m].")
    columns: Count = Field(41, description="Beams across the mirror, or lines of the sweep across.")
    rows: Count = Field(27, description="Beams along its height, or lines of the sweep along it.")
    target_m: Vector2 | None = Field(
        None, description="Width and height of the target, the laser in its middle; default: large enough [m]."
    )
