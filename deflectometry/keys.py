"""What measurement.toml of ``kind = "deflectometry"`` may say, and how it is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from deflectometry.planning.keys import BenchPlanSection
from deflectometry.setup.patterns import GrayCode
from heliogauge.errors import InputError
from heliogauge.measurement.files import image_files, refuse_missing_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.measurement.models import (
    DESIGN_KEYS,
    Count,
    DesignKeys,
    ImageFiles,
    MeasurementModel,
    Number,
    Outline,
    Positive,
    Section,
    Sigma,
    Sigma3,
    Text,
    Vector2,
    Vector3,
    repeated,
)
from heliogauge.short_repr import ShortRepr

# --- camera ---------------------------------------------------------------------------------------------------------


class CameraFile(Section):
    """A camera that was calibrated before: ``file = "camera.json"``."""

    file: Text = Field(description="File of a calibrated camera, such as camera.json.")


class CameraParameters(Section):
    """A camera written out: Brown model on normalised coordinates, pixel (0, 0) is the centre of the top-left pixel.

    The sigmas are independent of each other; a full covariance comes with a camera file.
    """

    width_px: Count = Field(description="Width of the images [px].")
    height_px: Count = Field(description="Height of the images [px].")
    focal_x_px: Positive = Field(description="Focal length over pixel pitch, along rows [px].")
    focal_y_px: Positive = Field(description="Focal length over pixel pitch, along columns [px].")
    center_x_px: Number = Field(description="Principal point, x; the centre of the top-left pixel is 0 [px].")
    center_y_px: Number = Field(description="Principal point, y; the centre of the top-left pixel is 0 [px].")
    skew: Number = Field(0.0, description="Skew of the image axes: columns that a unit of y/z adds [px].")
    k1: Number = Field(0.0, description="Radial distortion, second power (Brown, normalised coordinates).")
    k2: Number = Field(0.0, description="Radial distortion, fourth power.")
    k3: Number = Field(0.0, description="Radial distortion, sixth power.")
    p1: Number = Field(0.0, description="Tangential distortion, first coefficient.")
    p2: Number = Field(0.0, description="Tangential distortion, second coefficient.")
    distortion_direction: Literal["ideal_to_measured", "measured_to_ideal"] = Field(
        "ideal_to_measured",
        description="ideal_to_measured: OpenCV, Metashape, AICON; measured_to_ideal: PhotoModeler, DBAT, Australis.",
    )
    sigma_focal_px: Sigma = Field(
        0.0,
        description="Standard deviation of the focal length; 0.0: exact; without any sigma of the camera: "
        "known no better than the images know it [px].",
    )
    sigma_center_px: Sigma = Field(0.0, description="Standard deviation of each of its coordinates [px].")
    sigma_skew: Sigma = Field(0.0, description="Standard deviation of skew.")
    sigma_k1: Sigma = Field(0.0, description="Standard deviation of k1.")
    sigma_k2: Sigma = Field(0.0, description="Standard deviation of k2.")
    sigma_k3: Sigma = Field(0.0, description="Standard deviation of k3.")
    sigma_p1: Sigma = Field(0.0, description="Standard deviation of p1.")
    sigma_p2: Sigma = Field(0.0, description="Standard deviation of p2.")


def _camera_form(value: Any) -> str:
    given = value if isinstance(value, dict) else getattr(value, "__dict__", {})
    return "camera file" if "file" in given else "camera parameters"


CameraSection = Annotated[
    Annotated[CameraFile, Tag("camera file")] | Annotated[CameraParameters, Tag("camera parameters")],
    Discriminator(_camera_form),
]


# --- screen ---------------------------------------------------------------------------------------------------------


class PoseSection(Section):
    """A pose with its sigma: ``cam_from_screen``; of a mirror ``cam_from_facet``, of several ``cam_from_ensemble``."""

    rotation_vector_rad: Vector3 = Field(description="Rotation into the camera's frame, as a vector [rad].")
    translation_m: Vector3 = Field(description="Origin in the camera's frame [m].")
    sigma_rotation_mrad: Sigma3 = Field(
        (0.0, 0.0, 0.0), description="1 sigma about each axis; one number stands for three [mrad]."
    )
    sigma_translation_mm: Sigma3 = Field(
        (0.0, 0.0, 0.0), description="1 sigma along each axis; one number stands for three [mm]."
    )


class _ScreenSection(PoseSection):
    """What every screen has beside its pose: how well its shape is known, and the response of camera and display."""

    sigma_width_mm: Sigma = Field(0.0, description="Standard deviation of the displayed image's width [mm].")
    sigma_height_mm: Sigma = Field(0.0, description="Standard deviation of its height [mm].")
    sigma_sag_mm: Sigma = Field(
        0.0, description="How far its middle may stand out of the plane of its edges, 1 sigma [mm]."
    )
    sigma_points_mm: Sigma = Field(0.0, description="How far points are off the screen's shape, 1 sigma [mm].")
    response_file: Text | None = Field(
        None, description="Response of camera and display: columns camera_dn, display_level."
    )


class RectangularScreenSection(_ScreenSection):
    """A flat rectangular screen; its frame has the origin in the middle, x right, y up, z towards the viewer."""

    shape: Literal["rectangle"] = Field(description="A flat rectangular screen.")
    width_m: Positive = Field(description="Width of the displayed image, not of the housing [m].")
    height_m: Positive = Field(description="Height of the displayed image [m].")


class TabulatedScreenSection(_ScreenSection):
    """A screen of any shape: a CSV table with the columns u, v, x_m, y_m, z_m."""

    shape: Literal["table"] = Field(description="A screen of any shape, as a table of points.")
    file: Text = Field(description="Table of points of the screen: columns u, v, x_m, y_m, z_m.")


class DotScreenSection(_ScreenSection):
    """A field of dots on any surface: a CSV table with the columns column, row, x_m, y_m, z_m."""

    shape: Literal["dots"] = Field(description="A field of dots, as a table of their places.")
    file: Text = Field(
        description="Table of the dots: whole numbers column (to the right) and row (upwards as a viewer sees the "
        "screen), and the place of each in the screen's frame, x_m, y_m, z_m."
    )


class MeasuredScreenSection(Section):
    """A screen that ``deflectometry screen geometry`` measured, with all that its points and pose share.

    Its pose is in the file where a photo of the measuring camera was among its photos; otherwise it stands here.
    """

    shape: Literal["measured"] = Field(description="A screen from `heliogauge deflectometry screen geometry`.")
    file: Text = Field(description="Its screen.nc.")
    rotation_vector_rad: Vector3 | None = Field(
        None, description="Rotation of cam_from_screen as a vector; default: the file's pose [rad]."
    )
    translation_m: Vector3 | None = Field(
        None, description="The screen's origin in the camera's frame; default: the file's pose [m]."
    )
    sigma_rotation_mrad: Sigma3 = Field(
        (0.0, 0.0, 0.0), description="1 sigma about each axis of the pose that stands here [mrad]."
    )
    sigma_translation_mm: Sigma3 = Field(
        (0.0, 0.0, 0.0), description="1 sigma along each axis of the pose that stands here [mm]."
    )
    response_file: Text | None = Field(
        None, description="Response of camera and display: columns camera_dn, display_level."
    )

    @model_validator(mode="after")
    def _whole_pose(self) -> Self:
        if (self.rotation_vector_rad is None) != (self.translation_m is None):
            raise ValueError("rotation_vector_rad and translation_m belong together; give both, or none for the file's")
        stated = {"sigma_rotation_mrad", "sigma_translation_mm"} & self.model_fields_set
        if stated and self.translation_m is None:
            raise ValueError(f"{', '.join(sorted(stated))}: the file's pose has its own sigmas; leave it out")
        return self


ScreenSection = Annotated[
    RectangularScreenSection | TabulatedScreenSection | MeasuredScreenSection, Discriminator("shape")
]
DotFieldSection = Annotated[DotScreenSection | MeasuredScreenSection, Discriminator("shape")]
AnyScreenSection = RectangularScreenSection | TabulatedScreenSection | DotScreenSection | MeasuredScreenSection


# --- pattern and images ---------------------------------------------------------------------------------------------


class FringeSetSection(Section):
    """Frames of one axis and one number of periods: ``I_k = a + b cos(2 pi periods w - steps_k)``, w = u or v."""

    axis: Literal["x", "y"] = Field(
        description="Direction in which the fringes change: x from left to right, y from top to bottom."
    )
    # No display shows a period on a tenth of a pixel, or tells a hundredth of one from flat light.
    periods: Positive = Field(ge=0.01, le=1e5, description="Number of fringe periods over the displayed image.")
    steps_deg: Annotated[tuple[Number, ...], Field(min_length=3)] = Field(
        description="Phase step of each frame of the set, three or more [deg]."
    )


class KnownDisplaySection(Section):
    """A point of the image whose place on the display is known: orders of fringes are counted from there."""

    image_px: Vector2 = Field(description="Where it is in the image, x and y; must be on the mirror [px].")
    display: Vector2 = Field(description="Which fractions of the displayed image are seen there, u and v.")
    sigma_display: Positive = Field(description="Standard deviation of each fraction.")


class GrayCodeSection(Section):
    """Stripes of a Gray code: for each bit of the column, then of the row, a frame and its inverse, coarsest first."""

    width_px: Annotated[int, Field(ge=2, le=65536)] = Field(description="Width of the displayed image [px].")
    height_px: Annotated[int, Field(ge=2, le=65536)] = Field(description="Height of the displayed image [px].")

    @property
    def code(self) -> GrayCode:
        """The code that was shown."""
        return GrayCode(self.width_px, self.height_px)


class PatternSection(Section):
    """The fringe sets in the order in which their frames were taken, ``[[pattern.set]]``, or a Gray code."""

    set: tuple[FringeSetSection, ...] = Field(
        (), description="The fringe sets in the order in which their frames were taken."
    )
    known_point: KnownDisplaySection | None = Field(
        None, description="A point seen on the display, for fringes of one period, whose orders are counted from it."
    )
    gray_code: GrayCodeSection | None = Field(
        None, description="A Gray code instead of fringes, in the order of OpenCV's GrayCodePattern."
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if bool(self.set) == (self.gray_code is not None):
            raise ValueError("give either [[pattern.set]], the fringes shown, or [pattern.gray_code]")
        if self.gray_code is not None and self.known_point is not None:
            raise ValueError("known_point belongs to fringes; a Gray code says where on the display it is")
        return self

    @property
    def n_frames(self) -> int:
        """Number of frames of the whole pattern."""
        if self.gray_code is not None:
            return self.gray_code.code.n_frames
        return sum(len(fringe_set.steps_deg) for fringe_set in self.set)


class ImagesSection(Section):
    """Files of the measurement, relative to its folder; a text with ``*`` stands for all files that match.

    Files that match are taken in natural order: ``fringe_2`` before ``fringe_10``.
    """

    fringes: ImageFiles = Field(
        description="The fringe images in the order of the pattern: a text with * (natural order) or a list."
    )
    dark: Text | None = Field(None, description="Image with a black screen; helps to find the mirror.")
    bright: Text | None = Field(None, description="Image with a white screen; helps to find the mirror.")
    saturation_dn: Positive | None = Field(
        None, description="Level that counts as saturated; default: the file format's largest [DN]."
    )
    pixel_noise_dn: Positive | None = Field(None, description="1 sigma of a pixel; default: from the frames [DN].")


# --- mirror ---------------------------------------------------------------------------------------------------------


class FacetSection(DesignKeys):
    """One facet of an ensemble: ``[[mirror.facet]]``; the pose is ``ensemble_from_facet``.

    Without a design of its own the facet has the ensemble's.
    """

    name: Text = Field(description="Name of the facet, for tables and maps.")
    outline_m: Outline = Field(description="Corners in the facet's frame, counter-clockwise seen from the front [m].")
    position_m: Vector3 = Field(description="Origin of the facet in the ensemble's frame [m].")
    rotation_vector_rad: Vector3 = Field(
        (0.0, 0.0, 0.0), description="Rotation of ensemble_from_facet as a vector [rad]."
    )
    reference_point_m: Vector2 | None = Field(
        None, description="Reference of its results; default: the outline's centroid [m]."
    )
    sigma_position_mm: Sigma3 | None = Field(
        None, description="1 sigma of its place along each axis of the ensemble; default: the ensemble's [mm]."
    )
    mounts_m: Outline | None = Field(
        None, description="Its mounts, x and y in the facet's frame; default: mirror.mounts_m [m]."
    )


class DistanceSection(Section):
    """The measured distance from a point of the mirror's frame to the origin of the screen's frame."""

    distance_m: Positive = Field(
        description="Measured distance from the point of the mirror to the origin of the screen's frame [m]."
    )
    sigma_mm: Positive = Field(description="Its standard deviation [mm].")
    point_m: Vector3 = Field(
        (0.0, 0.0, 0.0), description="The point in the mirror's frame that it was measured from [m]."
    )


class PlaceSection(Section):
    """Where a survey has a point of the mirror, in the screen's frame: it tells the sight better than the lens does."""

    place_m: Vector3 = Field(description="The point in the screen's frame: x right, y up, z to the viewer [m].")
    sigma_mm: Sigma3 = Field(description="1 sigma of each coordinate; one number stands for three [mm].")
    point_m: Vector3 = Field(
        (0.0, 0.0, 0.0), description="The point in the mirror's frame whose place was surveyed [m]."
    )

    @model_validator(mode="after")
    def _uncertain(self) -> Self:
        if not min(self.sigma_mm) > 0:
            raise ValueError("sigma_mm: no survey is exact; give more than 0 for each coordinate")
        return self


class KnownPointSection(Section):
    """A point with known coordinates in the mirror's frame that was measured in the image."""

    point_m: Vector3 = Field(description="The point in the mirror's frame [m].")
    image_px: Vector2 = Field(description="Where it was measured in the image, x and y [px].")
    sigma_px: Positive = Field(0.5, description="Standard deviation of each image coordinate [px].")


def _check_mounts(name: str, mounts_m: tuple[Vector2, ...], outline_m: Outline) -> None:
    """Refuse mounts of a facet that are in other units, or that cannot turn it in both directions."""
    if not mounts_m:
        return
    mounts, outline = np.array(mounts_m), np.array(outline_m)
    middle = outline.mean(axis=0)
    size = float(np.hypot(*(outline - middle).T).max())
    for x, y in mounts[np.hypot(*(mounts - middle).T) > 2 * size].tolist():
        raise ValueError(
            f'mounts_m: [{x:g}, {y:g}] is far beside facet "{name}", whose corners are {size:g} m from its middle; '
            "are the coordinates in metres, and in the facet's frame?"
        )
    # A line of mounts turns a facet about one axis; 1 % of its size across would ask for 100 times the move.
    if float(np.linalg.svd(mounts - mounts.mean(axis=0), compute_uv=False)[1]) < 0.01 * size:
        raise ValueError(
            f'mounts_m: the mounts of facet "{name}" lie on a line, which turns it about one axis only; '
            "give three that do not"
        )


class MirrorSection(DesignKeys):
    """The mirror: design, outline or facets, and what is known of its pose.

    Facet frame: x width and y height seen from the front, z out of the mirror. The outline is a polygon in that
    frame, counter-clockwise seen from the front. ``outline_sigma_mm`` is the uncertainty of the polygon's sides,
    ``roll_deg`` how the mirror is turned in the image, counter-clockwise as displayed: this distinguishes positions in
    which a symmetric outline looks the same.
    """

    outline_m: Outline | None = Field(
        None, description="Corners in the facet's frame, counter-clockwise from the front; default: undefined [m]."
    )
    outline_sigma_mm: Sigma = Field(
        0.0, description="How far the real sides may be from that outline, 1 sigma; 0: exact [mm]."
    )
    roll_deg: Number = Field(
        0.0, description="From the image's x axis to the mirror's, counter-clockwise as displayed [deg]."
    )
    reference_point_m: Vector2 | None = Field(
        None, description="Reference of the results; default: the outline's centroid [m]."
    )
    facet: tuple[FacetSection, ...] = Field(
        (), description="Facets of an ensemble, one table each, instead of outline_m."
    )
    sigma_facet_position_mm: Sigma3 | None = Field(
        None,
        description="1 sigma of each facet's place along each axis of the ensemble; default: from its outline [mm].",
    )
    mounts_m: Outline | None = Field(
        None, description="Mounts of every facet, x and y in the facet's frame; each gets a move in mounts.csv [m]."
    )
    pose: PoseSection | None = Field(None, description="A pose measured otherwise; replaces the adjustment.")
    distance: DistanceSection | None = Field(None, description="Distance from mirror to screen, for the adjustment.")
    place: PlaceSection | None = Field(
        None, description="Surveyed place of a point of the mirror in the screen's frame; for far mirrors."
    )
    known_point: tuple[KnownPointSection, ...] = Field(
        (), description="Points of the mirror that were measured in the image."
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.design is None and not (self.facet and all(facet.design for facet in self.facet)):
            raise ValueError(f"design is missing; say one of {', '.join(DESIGN_KEYS)}")
        if self.outline_m is not None and self.facet:
            raise ValueError(
                "outline_m and [[mirror.facet]] are both given; an ensemble has outlines in its facets only"
            )
        if self.mounts_m is not None and not self.facet:
            raise ValueError(
                "mounts_m belongs to the facets of an ensemble; a mirror of one facet is turned as a whole, so that it "
                "has no canting"
            )
        if self.sigma_facet_position_mm is not None and not self.facet:
            raise ValueError(
                "sigma_facet_position_mm belongs to the facets of an ensemble; a mirror of one facet has its place as "
                "a whole ([mirror.pose] or its outline)"
            )
        if (twice := repeated(facet.name for facet in self.facet)) is not None:
            raise ValueError(f'two facets are called "{twice}"; each needs its own name')
        for facet in self.facet:
            _check_mounts(facet.name, facet.mounts_m or self.mounts_m or (), facet.outline_m)
        has_outline = self.outline_m is not None or bool(self.facet)
        if not (has_outline or self.pose or self.distance or len(self.known_point) >= 3):
            raise ValueError(
                "the mirror's place is not determined; give outline_m, [mirror.pose], [mirror.distance] "
                "or at least three [[mirror.known_point]]"
            )
        return self


class EvaluationSection(Section):
    """Choices of the evaluation; the command line can override them."""

    align: Literal["normal", "outline"] = Field(
        "normal", description="What slopes refer to: the pose found (outline), or the design's mean normal."
    )
    grid_step_mm: Positive | None = Field(
        None,
        description="Step of the maps; default: 0.4 to 1 image pixel, for 250 000 nodes where possible [mm].",
    )
    remove: Literal["nothing", "tilt", "focus", "quadratic"] = Field(
        "nothing", description="What is taken out of the maps and headline numbers."
    )


class BenchEvaluationSection(EvaluationSection):
    """Choices of the evaluation of images; the command line can override all but the last."""

    contradictions: Literal["refuse", "report"] = Field(
        "refuse", description="Whether a result that contradicts itself is refused, or written with a serious doubt."
    )


class BenchModel(MeasurementModel):
    """What the measurement.toml of every source says: camera, screen, mirror, and how it is evaluated."""

    camera: CameraSection = Field(description="The camera: a file from a calibration, or its parameters.")
    screen: AnyScreenSection = Field(description="The screen: shape, size and pose.")
    mirror: MirrorSection = Field(description="The mirror: design, outline or facets, and what is known of its pose.")
    evaluation: BenchEvaluationSection = Field(BenchEvaluationSection(), description="Choices of the evaluation.")


class DeflectometryModel(BenchModel):
    """The whole measurement.toml of ``kind = "deflectometry"``."""

    kind: Literal["deflectometry"] = Field(description="Fringe images of a mirror.")
    screen: ScreenSection = Field(description="The screen: shape, size and pose.")
    pattern: PatternSection = Field(description="The fringe pattern that was displayed.")
    images: ImagesSection = Field(description="The images.")
    plan: BenchPlanSection = Field(BenchPlanSection(), description="What a plan expects of the images.")

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


@dataclass(frozen=True, slots=True, eq=False)
class BenchMeasurement(ShortRepr):
    """A checked measurement of any source: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
    """

    folder: Path
    model: BenchModel

    def path(self, text: str) -> Path:
        """Return the path of a file named in measurement.toml."""
        return self.folder / text


@dataclass(frozen=True, slots=True, eq=False)
class DeflectometryMeasurement(BenchMeasurement):
    """A checked measurement with fringes.

    model: What measurement.toml says.
    fringe_files: Image of each frame, in the order of the pattern.
    """

    model: DeflectometryModel
    fringe_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        named = (self.path(text) for _, text in self.model.named_files())
        return (self.folder / MEASUREMENT_FILE, *named, *self.fringe_files)


def load_deflectometry(folder: Path) -> DeflectometryMeasurement:
    """Read and check the folder of a deflectometry measurement.

    Parameters
    ----------
    folder : Path
        Folder with measurement.toml; the files it names are relative to it.

    Returns
    -------
    DeflectometryMeasurement
        The measurement; every file it names exists.

    Raises
    ------
    InputError
        No such folder or file, not TOML, another kind, an unknown or missing key, a value of the wrong type or out of
        range, a file that does not exist, or a number of frames that does not fit the pattern.
    """
    file, model = read_measurement(folder, DeflectometryModel)
    refuse_missing_files(folder, model.named_files())
    fringe_files = image_files(folder, "images.fringes", model.images.fringes)
    needed = model.pattern.n_frames
    if len(fringe_files) != needed:
        shown = f"the pattern has {needed} frames ({len(model.pattern.set)} sets)"
        if model.pattern.gray_code is not None:
            shown = f"the Gray code has {needed} frames (a frame and its inverse for each bit, without black and white)"
        raise InputError(
            f"{file}: images.fringes = {model.images.fringes!r} gives {len(fringe_files)} files, but {shown}; name the "
            "files in the order of the pattern"
        )
    return DeflectometryMeasurement(folder, model, fringe_files)
