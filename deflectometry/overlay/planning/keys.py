"""What [plan] of measurement.toml may say for an overlay; measuring does not read it."""

from pydantic import Field

from heliogauge.measurement.models import Positive, Section, Sigma


class OverlayPlanSection(Section):
    """What `heliogauge deflectometry plan` expects of photos that are not there yet; measuring does not read it."""

    contrast_dn: Positive = Field(100.0, description="Expected light of the source's image above the facets [DN].")
    noise_dn: Positive = Field(1.0, description="Expected noise of a pixel, 1 sigma [DN].")
    blur_px: Positive = Field(0.8, description="Expected blur of the camera's images: Gaussian, 1 sigma [px].")
    difference_of_photos_mrad: Sigma | None = Field(
        None,
        description="By how much waves of the facets are expected to put the turn of one facet off in one photo, as "
        "difference_of_photos_rad of an earlier result has it; default: none, the facets have the design's shape "
        "[mrad].",
    )
