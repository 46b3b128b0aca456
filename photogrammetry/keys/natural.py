"""What measurement.toml says of natural features: photos without targets, or with few."""

from typing import Annotated

from pydantic import Field

from heliogauge.measurement.models import Section


class NaturalSection(Section):
    """Features of the surface itself, found and followed through the photos; alone, or beside coded targets."""

    max_features: Annotated[int, Field(strict=True, ge=50)] = 4000
    min_photos: Annotated[int, Field(strict=True, ge=2)] = 3
    max_points: Annotated[int, Field(strict=True, ge=10)] = 2000
