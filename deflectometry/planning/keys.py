"""What [plan] of measurement.toml may say for a mirror before a screen; measuring does not read it."""

from pydantic import Field

from heliogauge.measurement.models import Positive, Section, Sigma, Vector3


class BenchPlanSection(Section):
    """What `heliogauge deflectometry plan` expects of images that are not there yet; measuring does not read it."""

    mirror_m: Vector3 | None = Field(
        None,
        description="Where the mirror's origin will be in the camera's frame; it will show the screen's middle. "
        "Default: from [mirror.pose], [mirror.place], or on the camera's axis at [mirror.distance] [m].",
    )
    contrast_dn: Positive = Field(
        80.0,
        description="Expected amplitude of the coarsest fringes, or bright minus dark of dots, in the images [DN].",
    )
    noise_dn: Positive = Field(1.0, description="Expected noise of a pixel, 1 sigma [DN].")
    blur_px: Sigma = Field(0.7, description="Expected blur of the camera's images: Gaussian, 1 sigma [px].")
