"""What measurement.toml says of the targets in photos."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heliogauge.measurement_models import Positive, Section, Text, Vector3


class UncodedSection(Section):
    """A target without a code: its name and where it is, to some millimetres."""

    target: Text
    xyz_m: Vector3
    sigma_mm: Positive


class TargetsSection(Section):
    """Targets in the photos: ring codes (``aicon-12``, ``metashape-14``), square markers (``DICT_4X4_100``), dots.

    Dots without a code are matched through the poses that coded targets give; ``uncoded`` or ``uncoded_file`` names
    them.
    """

    dictionary: Text
    diameter_mm: Positive | None = None
    polarity: Literal["black-on-white", "white-on-black", "both"] = "both"
    smallest_px: Annotated[float, Field(strict=True, ge=3)] = 6.0
    largest_px: Positive = 100.0
    find_uncoded: bool | None = None
    uncoded: tuple[UncodedSection, ...] = ()
    uncoded_file: Text | None = None

    @model_validator(mode="after")
    def _one_list(self) -> Self:
        names = [one.target for one in self.uncoded]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"uncoded: target {twice} is listed twice")
        if self.find_uncoded is False and (self.uncoded or self.uncoded_file):
            raise ValueError("find_uncoded = false, but targets without a code are listed; leave one of both out")
        return self

    @property
    def has_markers(self) -> bool:
        """Whether the coded targets are square markers."""
        return self.dictionary.startswith("DICT_")

    @property
    def searches_dots(self) -> bool:
        """Whether dots without a code are searched for: by default beside ring codes, or where some are listed."""
        if self.find_uncoded is not None:
            return self.find_uncoded
        return not self.has_markers or bool(self.uncoded or self.uncoded_file)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the files that are named."""
        return (self.uncoded_file,) if self.uncoded_file else ()
