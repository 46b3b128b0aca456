"""What measurement.toml of ``kind = "deflectometry"`` may say, and how it is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from heliogauge.errors import InputError
from heliogauge.measurement.files import image_files
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
)

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


class DeflectometryModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "deflectometry"``."""

    kind: Literal["deflectometry"]
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


@dataclass(frozen=True, slots=True, eq=False)
class DeflectometryMeasurement:
    """A checked deflectometry measurement: what the file says, and where its files are.

    Parameters
    ----------
    folder : Path
        The measurement's folder.
    model : DeflectometryModel
        What measurement.toml says.
    fringe_files : tuple of Path
        Image of each frame, in the order of the pattern.
    """

    folder: Path
    model: DeflectometryModel
    fringe_files: tuple[Path, ...]

    def path(self, text: str) -> Path:
        """Return the path of a file named in measurement.toml."""
        return self.folder / text

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
    for key, text in model.named_files():
        if not (folder / text).is_file():
            raise InputError(f"{file}: {key} = {text!r}: there is no such file in {folder}")
    fringe_files = image_files(folder, "images.fringes", model.images.fringes)
    needed = model.pattern.n_frames
    if len(fringe_files) != needed:
        raise InputError(
            f"{file}: images.fringes = {model.images.fringes!r} gives {len(fringe_files)} files, but the pattern has "
            f"{needed} frames ({len(model.pattern.set)} sets); name the files in the order of the pattern"
        )
    return DeflectometryMeasurement(folder, model, fringe_files)
