"""What measurement files of several instruments may say: types of keys, and the sections that they share.

Numbers are taken as numbers only (no text that looks like one, no true/false), NaN and infinity are refused, unknown
keys are errors. A scalar sigma stands for three equal ones. Sections of one instrument stand in its own ``keys``.
"""

import datetime
from collections import Counter
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
Sigma = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Count = Annotated[int, Field(strict=True, gt=0)]
Index = Annotated[int, Field(strict=True, ge=0)]
Text = Annotated[str, Field(min_length=1)]
Vector2 = tuple[Number, Number]
Vector3 = tuple[Number, Number, Number]


def _three_times(value: Any) -> Any:
    is_scalar = isinstance(value, int | float) and not isinstance(value, bool)
    return (value, value, value) if is_scalar else value


Sigma3 = Annotated[tuple[Sigma, Sigma, Sigma], BeforeValidator(_three_times)]


def _listed(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


#: Names of files, photos, targets: a single one may stand without brackets.
Names = Annotated[tuple[Text, ...], BeforeValidator(_listed)]
SomeNames = Annotated[Names, Field(min_length=1)]
Outline = Annotated[tuple[Vector2, ...], Field(min_length=3)]


def repeated(names: Iterable[str]) -> str | None:
    """Return the first name that occurs twice.

    >>> repeated(["a", "b", "a"])
    'a'
    """
    return next((name for name, count in Counter(names).items() if count > 1), None)


class Section(BaseModel):
    """Base of all sections: frozen, no unknown keys."""

    # Deferred: only the outermost model builds its validator (7 ms instead of 60 ms for all of them).
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class MeasurementModel(Section):
    """What every measurement.toml says; each kind adds its own sections."""

    kind: str = Field(description="Which kind of measurement this is; decides which keys the file may have.")
    name: Text = Field(description="Name of what is measured, for reports and files.")
    date: datetime.date | datetime.datetime | None = Field(
        None, description="Day or time of the measurement; only passed on."
    )
    notes: str = Field("", description="Free text for the reader; only passed on.")


# --- images ---------------------------------------------------------------------------------------------------------

ImageFiles = Annotated[
    Annotated[Text, Tag("text")] | Annotated[tuple[Text, ...], Field(min_length=1), Tag("list")],
    Discriminator(lambda value: "text" if isinstance(value, str) else "list"),
]


class PhotosSection(Section):
    """Photos, relative to the folder; a text with ``*`` stands for all files that match."""

    photos: ImageFiles = Field(
        description="Photos beside measurement.toml: a text with * (in natural order) or a list."
    )


# --- cameras --------------------------------------------------------------------------------------------------------

Intrinsic = Literal["focal_px", "aspect", "center_x_px", "center_y_px", "skew", "k1", "k2", "p1", "p2", "k3"]


# --- designs --------------------------------------------------------------------------------------------------------

DESIGN_KEYS: dict[str, tuple[str, ...]] = {
    "plane": (),
    "paraboloid": ("focal_length_m",),
    "paraboloid_xy": ("focal_length_x_m", "focal_length_y_m"),
    "trough": ("focal_length_m",),
    "sphere": ("radius_m",),
    "quadric": ("coefficients",),
}
_ALL_DESIGN_KEYS = ("focal_length_m", "focal_length_x_m", "focal_length_y_m", "radius_m", "coefficients")


class DesignKeys(Section):
    """A design surface; `DESIGN_KEYS` says which numbers each shape needs."""

    design: Literal["plane", "paraboloid", "paraboloid_xy", "trough", "sphere", "quadric"] | None = Field(
        None, description="Shape of the design surface; each has its own focal length, radius or coefficients."
    )
    focal_length_m: Positive | None = Field(None, description="Focal length of a paraboloid or trough [m].")
    focal_length_x_m: Positive | None = Field(None, description="Focal length in x of paraboloid_xy [m].")
    focal_length_y_m: Positive | None = Field(None, description="Focal length in y of paraboloid_xy [m].")
    radius_m: Positive | None = Field(None, description="Radius of a sphere [m].")
    coefficients: tuple[Number, Number, Number, Number, Number, Number] | None = Field(
        None, description="A to F of a quadric z = A x^2 + B y^2 + C x + D y + E x y + F [1/m, 1/m, 1, 1, 1/m, m]."
    )
    design_center_m: Vector2 = Field(
        (0.0, 0.0), description="Place of the facet's origin on the optic, x and y; [0, 0]: on axis [m]."
    )
    design_orientation: Literal["axis", "normal"] = Field(
        "normal", description="Facet's z axis: along the surface's normal there, or the optic's axis."
    )

    @model_validator(mode="after")
    def _numbers_fit_the_shape(self) -> Self:
        needed = DESIGN_KEYS[self.design] if self.design else ()
        given = [key for key in _ALL_DESIGN_KEYS if getattr(self, key) is not None]
        missing = [key for key in needed if key not in given]
        extra = [key for key in given if key not in needed]
        if self.design is None and given:
            raise ValueError(f"{given[0]} is given without design; say which shape it belongs to")
        if missing:
            raise ValueError(f'design = "{self.design}" needs {" and ".join(missing)}')
        if extra:
            raise ValueError(f'{extra[0]} does not belong to design = "{self.design}"; leave it out')
        return self
