"""Keys of natural features: photos without targets, or with few."""

from typing import Annotated

from pydantic import Field

from heliogauge.measurement.models import Section


class NaturalSection(Section):
    """Features of the surface itself, found and followed through the photos; alone, or beside coded targets."""

    max_features: Annotated[int, Field(strict=True, ge=50)] = Field(
        4000, description="Features that are looked for in each photo."
    )
    min_photos: Annotated[int, Field(strict=True, ge=2)] = Field(3, description="Photos that must show a point.")
    max_points: Annotated[int, Field(strict=True, ge=10)] = Field(
        2000, description="Points that are kept, those seen in most photos first, spread over the photos."
    )
