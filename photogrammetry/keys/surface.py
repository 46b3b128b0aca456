"""What measurement.toml of ``kind = "photogrammetry"`` may say of the surface under the targets: ``[surface]``."""

from typing import Literal, Self

from pydantic import Field, model_validator

from heliogauge.measurement.models import (
    DESIGN_KEYS,
    DesignKeys,
    Outline,
    Positive,
    Section,
    SomeNames,
    Text,
    Vector2,
    Vector3,
    repeated,
)

#: Names, patterns with ``*`` and ``?``, and ranges ``17..32`` or ``A1..A9``.
TargetNames = SomeNames


class ReferenceTargetSection(Section):
    """A target whose place on the design is known: ``[[surface.reference]]``."""

    target: Text = Field(description="Name of the target.")
    xyz_m: Vector3 = Field(description="Its place in the design's frame [m].")


class SurfaceFacetSection(DesignKeys):
    """One facet: its targets, and its design pose ``design_from_facet`` where it has a design of its own."""

    name: Text = Field(description="Name of the facet.")
    targets: TargetNames = Field(description="Its targets: names, ranges 1..12, patterns A*.")
    outline_m: Outline | None = Field(None, description="Corners of its slope map, in its design's frame [m].")
    position_m: Vector3 = Field((0.0, 0.0, 0.0), description="Origin of its own design in the frame of all [m].")
    rotation_vector_rad: Vector3 = Field(
        (0.0, 0.0, 0.0), description="Rotation of design_from_facet as a vector [rad]."
    )
    reference_point_m: Vector2 | None = Field(
        None, description="Reference of its results; default: the outline's centroid [m]."
    )


class SurfaceSection(DesignKeys):
    """The design surface, or a CAD mesh, that the targets are compared with; another date; what is written."""

    fit: Literal["rigid", "focal-length", "none"] = Field(
        "rigid", description="Placing of the design: rigid motion, focal length estimated too, or none."
    )
    robust: bool = Field(True, description="Points far from the rest do not count (see surface.csv).")
    targets: TargetNames | None = Field(None, description="Names, ranges 1..40, patterns A*; default: all.")
    reference: tuple[ReferenceTargetSection, ...] = Field(
        (), description="Targets with a known place on the design, three or more."
    )
    facet: tuple[SurfaceFacetSection, ...] = Field((), description="Facets on one structure: canting, focal length.")
    outline_m: Outline | None = Field(
        None, description="Corners of the slope map; default: the targets' convex hull [m]."
    )
    slope_map: bool = Field(True, description="Write slope_map.nc.")
    grid_step_mm: Positive | None = Field(
        None, description="Step of the slope map; default: half the targets' distance [mm]."
    )
    mesh: Text | None = Field(None, description="CAD mesh to compare with, instead of a design.")
    mesh_unit: Literal["m", "mm"] = Field("m", description="Unit of the mesh's coordinates.")
    ply: bool = Field(False, description="Write points.ply; needs pip install heliogauge[3d].")
    compare_with: Text | None = Field(None, description="Folder of an earlier result: what moved since.")
    stable_targets: TargetNames | None = Field(
        None, description="Targets at rest since then; default: found by a test."
    )

    @model_validator(mode="after")
    def _something_to_do(self) -> Self:
        own = bool(self.facet) and all(facet.design for facet in self.facet)
        if self.design is not None and self.mesh is not None:
            raise ValueError("design and mesh are both given; compare with one of them")
        if self.design is None and not own and (self.facet or not (self.mesh or self.compare_with)):
            raise ValueError(f"design is missing; say one of {', '.join(DESIGN_KEYS)} (or give mesh or compare_with)")
        if self.fit == "focal-length" and (not self.curvable or any(facet.design for facet in self.facet)):
            raise ValueError('fit = "focal-length" needs one design with a focal length or radius for all targets')
        if self.stable_targets is not None and self.compare_with is None:
            raise ValueError("stable_targets belong to compare_with, which is missing")
        if self.reference and len(self.reference) < 3:
            raise ValueError(f"{len(self.reference)} [[surface.reference]] are too few; three or more place the design")
        for what, names in (
            ("facets", [one.name for one in self.facet]),
            ("references", [one.target for one in self.reference]),
        ):
            if (twice := repeated(names)) is not None:
                raise ValueError(f'two {what} are called "{twice}"')
        return self

    @property
    def curvable(self) -> bool:
        """Whether the design has lengths that can be estimated."""
        return self.design is not None and self.design not in ("plane", "quadric")

    @property
    def names(self) -> list[str]:
        """Files that the section names, relative to the measurement's folder."""
        other = [] if self.compare_with is None else [f"{self.compare_with}/points.csv"]
        return other if self.mesh is None else [self.mesh, *other]

    @property
    def has_design(self) -> bool:
        """Whether there is a surface by formula."""
        return self.design is not None or bool(self.facet)
