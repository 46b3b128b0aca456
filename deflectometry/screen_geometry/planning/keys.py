"""What [plan] of measurement.toml may say for photos of a screen; measuring does not read it."""

from pydantic import Field

from heliogauge.measurement.models import Count, Number, Positive, Section, Text, Vector3


class ScreenPlanSection(Section):
    """What `heliogauge deflectometry plan` expects of screen, photos and mirror; measuring does not read it.

    Places are in the screen's frame: origin in its middle, x to the right, y up, z towards the viewer.
    """

    width_m: Positive = Field(description="Width of the display, or of the field from the first to the last dot [m].")
    height_m: Positive = Field(description="Its height [m].")
    sag_mm: Number = Field(
        0.0, description="How far its middle lies behind its left and right edge, as bent to a parabola [mm]."
    )
    columns: Count = Field(30, ge=2, description="Columns of a field of dots.")
    rows: Count = Field(20, ge=2, description="Rows of a field of dots.")
    targets: Text | None = Field(
        None,
        description="Table of the coded targets around a field of dots: columns target, u, v as in [display]; default: "
        "fourteen around it, 0 to 13 from its lower left corner to the right and around.",
    )
    target_mm: Positive = Field(60.0, description="Side of a square marker [mm].")
    places_m: tuple[Vector3, ...] = Field(
        (),
        description="Where the photos will be taken; each looks at the middle. Default: eight places, six of them 40 "
        "degrees from the front, from which the targets fill the image [m].",
    )
    measuring_place_m: Vector3 | None = Field(
        None, description="Where the measuring camera will stand; default: before the middle, twice the width away [m]."
    )
    sigma_target_px: Positive = Field(
        0.03, description="Expected sigma of a target's image coordinate: of a marker's corner, or a round target [px]."
    )
    sigma_dot_px: Positive = Field(0.02, description="Expected sigma of a dot's image coordinate [px].")
    mirror_m: Positive | None = Field(
        None, description="From the screen to the mirror that it will measure: gives the slope error it causes [m]."
    )
    fringe_noise_mrad: Positive | None = Field(
        None, description="Noise of slopes in that mirror, which the slope error is compared with [mrad]."
    )
