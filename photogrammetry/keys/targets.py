"""Keys of the targets in photos."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heliogauge.measurement.models import Positive, Section, Text, Vector3, repeated


class UncodedSection(Section):
    """A target without a code: its name and where it is, to some millimetres."""

    target: Text = Field(description="Name of the target.")
    xyz_m: Vector3 = Field(description="Where it is, to some millimetres [m].")
    sigma_mm: Positive = Field(description="Standard deviation of that place, each coordinate [mm].")


class CharucoTargetSection(Section):
    """A ChArUco board in the scene, of the markers of the dictionary; columns and rows count squares."""

    columns: Annotated[int, Field(strict=True, ge=4)] = Field(description="Squares in a row.")
    rows: Annotated[int, Field(strict=True, ge=4)] = Field(description="Squares in a column.")
    square_mm: Positive = Field(description="Side of a square [mm].")
    marker_mm: Positive = Field(description="Side of a marker [mm].")

    @model_validator(mode="after")
    def _markers_in_squares(self) -> Self:
        if self.marker_mm >= self.square_mm:
            raise ValueError("marker_mm must be smaller than square_mm")
        return self


class TargetsSection(Section):
    """Targets in the photos: ring codes (``aicon-12``, ``metashape-14``), square markers (``DICT_4X4_100``), dots.

    A dictionary that ends in .csv or .toml is a file with ring codes of one's own. Dots without a code are matched
    through the poses that coded targets give; ``uncoded`` or ``uncoded_file`` names them. Without a dictionary they are
    identified by that list alone, with a known camera, or followed from marks set by hand (``tracked_from``).
    """

    dictionary: Text | None = Field(
        None, description="Ring codes (aicon-12, metashape-14), square markers (DICT_4X4_100), or a file."
    )
    square_dictionary: Text | None = Field(
        None, description="Square markers that stand beside ring codes (DICT_4X4_100)."
    )
    sense: Literal["clockwise", "counterclockwise"] | None = Field(
        None, description="Sense of the printed codes; default: the dictionary's."
    )
    ring_inner_radius: Positive | None = Field(
        None, description="Inner radius of the code ring, in radii of the dot; default: found from the photos."
    )
    ring_outer_radius: Positive | None = Field(
        None, description="Outer radius of the code ring, in radii of the dot; default: found from the photos."
    )
    diameter_mm: Positive | None = Field(
        None, description="Diameter of all dots: helps targets seen twice, and is checked [mm]."
    )
    polarity: Literal["black-on-white", "white-on-black", "both"] = Field(
        "both", description="Which is printed on which."
    )
    smallest_px: Annotated[float, Field(strict=True, ge=3)] = Field(
        6.0, description="Smallest diameter of a dot in the photos [px]."
    )
    largest_px: Positive = Field(300.0, description="Largest diameter of a dot in the photos [px].")
    find_uncoded: bool | None = Field(
        None, description="Find dots without a code; default: beside ring codes, or if listed."
    )
    uncoded: tuple[UncodedSection, ...] = Field((), description="Names and rough places of dots without a code.")
    uncoded_file: Text | None = Field(None, description="Table of those: columns id, x_m, y_m, z_m, sigma_mm.")
    up: Vector3 | None = Field(
        None, description="Direction in the list that points up in the photos, for symmetric layouts."
    )
    front: Vector3 | None = Field(None, description="Direction in the list towards the camera, for symmetric layouts.")
    tracked_from: Text | None = Field(
        None, description="Marks set by hand in one photo, then followed: columns image, target, x_px, y_px."
    )
    charuco: CharucoTargetSection | None = Field(
        None, description="A ChArUco board in the scene: its inner corners become points."
    )
    search_radius_px: Annotated[float, Field(strict=True, ge=4)] = Field(
        100.0, description="Farthest movement of a followed target from one photo to the next [px]."
    )

    @model_validator(mode="after")
    def _one_list(self) -> Self:
        if self.dictionary is None and self.tracked_from is None and not self.is_listed:
            raise ValueError(
                "say which dictionary the targets in the photos are from; or list targets without a code "
                "(uncoded_file), or name a file with marks set by hand (tracked_from)"
            )
        if self.square_dictionary is not None and (self.has_markers or not self.square_dictionary.startswith("DICT_")):
            raise ValueError(
                "square_dictionary: the name of square markers beside ring codes or dots is needed, DICT_...; square "
                "markers alone are the dictionary"
            )
        if self.charuco is not None and not self.has_markers:
            raise ValueError("charuco: the dictionary must be that of the board's markers, DICT_...")
        if (twice := repeated(one.target for one in self.uncoded)) is not None:
            raise ValueError(f"uncoded: target {twice} is listed twice")
        if self.find_uncoded is False and self.is_listed:
            raise ValueError("find_uncoded = false, but targets without a code are listed; leave one of both out")
        return self

    @property
    def has_markers(self) -> bool:
        """Whether the coded targets are square markers."""
        return self.dictionary is not None and self.dictionary.startswith("DICT_")

    @property
    def dictionary_file(self) -> str | None:
        """The file with a user's own ring codes, if the dictionary is one."""
        is_file = self.dictionary is not None and self.dictionary.lower().endswith((".csv", ".toml"))
        return self.dictionary if is_file else None

    @property
    def is_listed(self) -> bool:
        """Whether targets without a code are listed with rough places."""
        return bool(self.uncoded or self.uncoded_file)

    @property
    def searches_dots(self) -> bool:
        """Whether dots without a code are searched for: by default beside ring codes, or where some are listed."""
        if self.find_uncoded is not None:
            return self.find_uncoded
        return self.is_listed or (self.dictionary is not None and not self.has_markers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the files that are named."""
        return tuple(name for name in (self.dictionary_file, self.uncoded_file, self.tracked_from) if name is not None)
