"""What measurement.toml may say: one validated model for each section, units in the key names.

Numbers are taken as numbers only (no text that looks like one, no true/false), NaN and infinity are refused, unknown
keys are errors. A scalar sigma stands for three equal ones. `heliogauge.measurement.load` reads and writes the file.
"""

import datetime
from collections.abc import Iterator
from itertools import pairwise
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
Outline = Annotated[tuple[Vector2, ...], Field(min_length=3)]


class Section(BaseModel):
    """Base of all sections: frozen, no unknown keys."""

    # Deferred: only the outermost model builds its validator (7 ms instead of 60 ms for all of them).
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


# --- camera ---------------------------------------------------------------------------------------------------------


class CameraFile(Section):
    """A camera that was calibrated before: ``file = "camera.json"``."""

    file: Text


class CameraParameters(Section):
    """A camera written out: Brown model on normalised coordinates, pixel (0, 0) is the centre of the top-left pixel.

    The sigmas are independent of each other; a full covariance comes with a camera file.
    """

    width_px: Count
    height_px: Count
    focal_x_px: Positive
    focal_y_px: Positive
    center_x_px: Number
    center_y_px: Number
    skew: Number = 0.0
    k1: Number = 0.0
    k2: Number = 0.0
    k3: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0
    distortion_direction: Literal["ideal_to_measured", "measured_to_ideal"] = "ideal_to_measured"
    sigma_focal_px: Sigma = 0.0
    sigma_center_px: Sigma = 0.0
    sigma_skew: Sigma = 0.0
    sigma_k1: Sigma = 0.0
    sigma_k2: Sigma = 0.0
    sigma_k3: Sigma = 0.0
    sigma_p1: Sigma = 0.0
    sigma_p2: Sigma = 0.0


def _camera_form(value: Any) -> str:
    given = value if isinstance(value, dict) else getattr(value, "__dict__", {})
    return "camera file" if "file" in given else "camera parameters"


CameraSection = Annotated[
    Annotated[CameraFile, Tag("camera file")] | Annotated[CameraParameters, Tag("camera parameters")],
    Discriminator(_camera_form),
]


# --- screen ---------------------------------------------------------------------------------------------------------


class _ScreenPose(Section):
    """Keys that every screen has: its pose ``cam_from_screen`` with sigma, and the response of camera and display."""

    rotation_vector_rad: Vector3
    translation_m: Vector3
    sigma_rotation_mrad: Sigma3 = (0.0, 0.0, 0.0)
    sigma_translation_mm: Sigma3 = (0.0, 0.0, 0.0)
    sigma_points_mm: Sigma = 0.0
    response_file: Text | None = None


class RectangularScreenSection(_ScreenPose):
    """A flat rectangular screen; its frame has the origin in the middle, x right, y up, z towards the viewer."""

    shape: Literal["rectangle"]
    width_m: Positive
    height_m: Positive


class TabulatedScreenSection(_ScreenPose):
    """A screen of any shape: a CSV table with the columns u, v, x_m, y_m, z_m."""

    shape: Literal["table"]
    file: Text


ScreenSection = Annotated[RectangularScreenSection | TabulatedScreenSection, Discriminator("shape")]


# --- pattern and images ---------------------------------------------------------------------------------------------


class FringeSetSection(Section):
    """Frames of one axis and one number of periods: ``I_k = a + b cos(2 pi periods w - steps_k)``, w = u or v."""

    axis: Literal["x", "y"]
    periods: Positive
    steps_deg: Annotated[tuple[Number, ...], Field(min_length=3)]


class PatternSection(Section):
    """The fringe sets in the order in which their frames were taken: ``[[pattern.set]]``."""

    set: Annotated[tuple[FringeSetSection, ...], Field(min_length=1)]

    @property
    def n_frames(self) -> int:
        """Number of frames of the whole pattern."""
        return sum(len(fringe_set.steps_deg) for fringe_set in self.set)


ImageFiles = Annotated[
    Annotated[Text, Tag("text")] | Annotated[tuple[Text, ...], Field(min_length=1), Tag("list")],
    Discriminator(lambda value: "text" if isinstance(value, str) else "list"),
]


class ImagesSection(Section):
    """Files of the measurement, relative to its folder; a text with ``*`` stands for all files that match.

    Files that match are taken in natural order: ``fringe_2`` before ``fringe_10``.
    """

    fringes: ImageFiles
    dark: Text | None = None
    bright: Text | None = None
    saturation_dn: Positive | None = None
    pixel_noise_dn: Positive | None = None


# --- mirror ---------------------------------------------------------------------------------------------------------

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
    """A design surface; `DESIGN_KEYS` says which numbers each shape needs.

    ``coefficients`` are A .. F of ``z = A x^2 + B y^2 + C x + D y + E x y + F`` [1/m, 1/m, 1, 1, 1/m, m].
    """

    design: Literal["plane", "paraboloid", "paraboloid_xy", "trough", "sphere", "quadric"] | None = None
    focal_length_m: Positive | None = None
    focal_length_x_m: Positive | None = None
    focal_length_y_m: Positive | None = None
    radius_m: Positive | None = None
    coefficients: tuple[Number, Number, Number, Number, Number, Number] | None = None
    design_center_m: Vector2 = (0.0, 0.0)
    design_orientation: Literal["axis", "normal"] = "normal"

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


class FacetSection(DesignKeys):
    """One facet of an ensemble: ``[[mirror.facet]]``; the pose is ``ensemble_from_facet``.

    Without a design of its own the facet has the ensemble's.
    """

    name: Text
    outline_m: Outline
    position_m: Vector3
    rotation_vector_rad: Vector3 = (0.0, 0.0, 0.0)
    reference_point_m: Vector2 | None = None


class PoseSection(Section):
    """A pose that was measured otherwise: ``cam_from_facet``, or ``cam_from_ensemble`` where there are facets."""

    rotation_vector_rad: Vector3
    translation_m: Vector3
    sigma_rotation_mrad: Sigma3 = (0.0, 0.0, 0.0)
    sigma_translation_mm: Sigma3 = (0.0, 0.0, 0.0)


class DistanceSection(Section):
    """The measured distance from a point of the mirror's frame to the origin of the screen's frame."""

    distance_m: Positive
    sigma_mm: Positive
    point_m: Vector3 = (0.0, 0.0, 0.0)


class KnownPointSection(Section):
    """A point with known coordinates in the mirror's frame that was measured in the image."""

    point_m: Vector3
    image_px: Vector2
    sigma_px: Positive = 0.5


class MirrorSection(DesignKeys):
    """The mirror: design, outline or facets, and what is known of its pose.

    Facet frame: x width and y height seen from the front, z out of the mirror. The outline is a polygon in that
    frame, counter-clockwise seen from the front. ``outline_sigma_mm`` says how well the polygon's sides are known,
    ``roll_deg`` how the mirror is turned in the image, counter-clockwise as displayed: this distinguishes positions in
    which a symmetric outline looks the same.
    """

    outline_m: Outline | None = None
    outline_sigma_mm: Sigma = 0.0
    roll_deg: Number = 0.0
    reference_point_m: Vector2 | None = None
    facet: tuple[FacetSection, ...] = ()
    pose: PoseSection | None = None
    distance: DistanceSection | None = None
    known_point: tuple[KnownPointSection, ...] = ()

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.design is None and not (self.facet and all(facet.design for facet in self.facet)):
            raise ValueError(f"design is missing; say one of {', '.join(DESIGN_KEYS)}")
        if self.outline_m is not None and self.facet:
            raise ValueError(
                "outline_m and [[mirror.facet]] are both given; an ensemble has outlines in its facets only"
            )
        names = [facet.name for facet in self.facet]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f'two facets are called "{twice}"; each needs its own name')
        has_outline = self.outline_m is not None or bool(self.facet)
        if not (has_outline or self.pose or self.distance or len(self.known_point) >= 3):
            raise ValueError(
                "nothing says where the mirror is; give outline_m, [mirror.pose], [mirror.distance] "
                "or at least three [[mirror.known_point]]"
            )
        return self


class EvaluationSection(Section):
    """Choices of the evaluation; the command line can override them.

    ``align`` says which mean orientation the slopes refer to: ``outline`` keeps the pose that was found,
    ``normal`` turns the mirror so that its mean normal is the design's.
    """

    align: Literal["normal", "outline"] = "normal"
    grid_step_mm: Positive | None = None
    remove: Literal["nothing", "tilt", "focus", "quadratic"] = "nothing"


class DeflectometryModel(Section):
    """The whole measurement.toml of ``kind = "deflectometry"``."""

    kind: Literal["deflectometry"]
    name: Text
    date: datetime.date | datetime.datetime | None = None
    notes: str = ""
    camera: CameraSection
    screen: ScreenSection
    pattern: PatternSection
    images: ImagesSection
    mirror: MirrorSection
    evaluation: EvaluationSection = EvaluationSection()

    def named_files(self) -> Iterator[tuple[str, str]]:
        """Yield the key path and the text of every single file that is named (the fringes are not among them)."""
        candidates = (
            ("camera.file", getattr(self.camera, "file", None)),
            ("screen.file", getattr(self.screen, "file", None)),
            ("screen.response_file", self.screen.response_file),
            ("images.dark", self.images.dark),
            ("images.bright", self.images.bright),
        )
        yield from ((key, text) for key, text in candidates if text is not None)


# --- response of camera and display ---------------------------------------------------------------------------------


class DisplaySection(Section):
    """The grey levels that were shown, in the order of the photographs.

    ``full_level`` is the display's brightest level: 255 for 8 bit, 1 where levels are written as fractions.
    """

    levels: Annotated[tuple[Sigma, ...], Field(min_length=3)]
    full_level: Positive = 255.0

    @model_validator(mode="after")
    def _ascending_within_the_range(self) -> Self:
        for position, (level, following) in enumerate(pairwise(self.levels), start=1):
            if following <= level:
                raise ValueError(
                    f"levels must ascend, but level {position} is {level:g} and level {position + 1} is {following:g}; "
                    "put photographs and levels in the order dark to bright"
                )
        if self.levels[-1] > self.full_level:
            raise ValueError(f"level {self.levels[-1]:g} is above full_level = {self.full_level:g}")
        return self


class GreyImagesSection(Section):
    """Photographs of the grey levels, relative to the folder; a text with ``*`` stands for all files that match.

    ``region_px`` is x and y of the first and of the last pixel to use.
    """

    grey: ImageFiles
    saturation_dn: Positive | None = None
    region_px: tuple[Index, Index, Index, Index] | None = None

    @model_validator(mode="after")
    def _region_has_an_area(self) -> Self:
        if self.region_px is not None:
            x_first, y_first, x_last, y_last = self.region_px
            if x_last < x_first or y_last < y_first:
                raise ValueError(f"region_px = {list(self.region_px)}: x and y of the last pixel are below the first")
        return self


class ResponseModel(Section):
    """The whole measurement.toml of ``kind = "response"``."""

    kind: Literal["response"]
    name: Text
    date: datetime.date | datetime.datetime | None = None
    notes: str = ""
    display: DisplaySection
    images: GreyImagesSection


# --- calibration of a camera ----------------------------------------------------------------------------------------

Intrinsic = Literal["focal_px", "aspect", "center_x_px", "center_y_px", "skew", "k1", "k2", "p1", "p2", "k3"]


class CalibratedCameraSection(Section):
    """The camera to calibrate: its size, to check the photos against, and which intrinsics are estimated."""

    name: Text = "camera"
    width_px: Count | None = None
    height_px: Count | None = None
    free: Annotated[tuple[Intrinsic, ...], Field(min_length=1)] = (
        "focal_px",
        "aspect",
        "center_x_px",
        "center_y_px",
        "k1",
        "k2",
        "p1",
        "p2",
        "k3",
    )


class ChessboardSection(Section):
    """A chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"]
    columns: Count
    rows: Count
    square_mm: Positive | None = None


class CharucoSection(Section):
    """A ChArUco board; columns and rows count squares."""

    type: Literal["charuco"]
    columns: Count
    rows: Count
    square_mm: Positive
    marker_mm: Positive
    dictionary: Text


class CircleGridSection(Section):
    """A grid of dots; in the asymmetric one every second row is shifted by half a pitch and rows are half as far."""

    type: Literal["circles", "circles-asymmetric"]
    columns: Count
    rows: Count
    pitch_mm: Positive | None = None
    diameter_mm: Positive | None = None

    @model_validator(mode="after")
    def _diameter_needs_the_pitch(self) -> Self:
        if self.diameter_mm is not None and self.pitch_mm is None:
            raise ValueError("diameter_mm says nothing without pitch_mm; give both or neither")
        return self


class TargetFieldSection(Section):
    """A plate with coded targets; the file has the columns id, x_m, y_m and perhaps z_m, known to a few per cent.

    Without a file nothing is known of the targets' places, and they need not be near a plane. A dictionary that ends in
    .csv or .toml is a file with ring codes of one's own.
    """

    type: Literal["targets"]
    dictionary: Text
    file: Text | None = None

    @property
    def named_files(self) -> tuple[tuple[str, str], ...]:
        """Keys that name files, with the names."""
        own = self.dictionary if self.dictionary.lower().endswith((".csv", ".toml")) else None
        return tuple((key, name) for key, name in (("dictionary", own), ("file", self.file)) if name)


BoardSection = Annotated[
    ChessboardSection | CharucoSection | CircleGridSection | TargetFieldSection, Discriminator("type")
]


class PhotosSection(Section):
    """Photos, relative to the folder; a text with ``*`` stands for all files that match."""

    photos: ImageFiles


class CameraCalibrationModel(Section):
    """The whole measurement.toml of ``kind = "camera"``."""

    kind: Literal["camera"]
    name: Text
    date: datetime.date | datetime.datetime | None = None
    notes: str = ""
    camera: CalibratedCameraSection = CalibratedCameraSection()
    board: BoardSection
    images: PhotosSection
