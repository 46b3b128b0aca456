"""What [plan] of measurement.toml may say for a photo of dots; measuring does not read it."""

from pydantic import Field

from deflectometry.planning.keys import BenchPlanSection
from heliogauge.measurement.models import Positive


class DotsPlanSection(BenchPlanSection):
    """What `heliogauge deflectometry plan` expects of a photo of dots."""

    dot_radius_mm: Positive | None = Field(
        None, description="Radius of a dot; default: from pattern.marks_file, else a quarter of their distance [mm]."
    )
