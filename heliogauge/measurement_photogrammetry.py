"""What measurement.toml of ``kind = "photogrammetry"`` may say."""

import datetime
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, model_validator

from heliogauge.measurement_models import (
    Count,
    Intrinsic,
    Number,
    PhotosSection,
    Positive,
    Section,
    Sigma3,
    Text,
    Vector3,
)

#: Intrinsics of a camera of which nothing is known but its size.
SELF_CALIBRATED: tuple[Intrinsic, ...] = (
    "focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3",
)  # fmt: skip


class NetworkCameraSection(Section):
    """The camera: a file or start values, and which intrinsics are estimated.

    Without a file and without ``focal_px`` the camera calibrates itself. A known camera is held unless ``free`` names
    intrinsics; ``prior = true`` weighs them by the covariance of the file, ``sigma`` by single sigmas.
    """

    name: Text = "camera"
    file: Text | None = None
    width_px: Count | None = None
    height_px: Count | None = None
    focal_px: Positive | None = None
    focal_length_35mm: Positive | None = None
    aspect: Number = 0.0
    center_x_px: Number | None = None
    center_y_px: Number | None = None
    skew: Number = 0.0
    k1: Number = 0.0
    k2: Number = 0.0
    k3: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0
    distortion_direction: Literal["ideal_to_measured", "measured_to_ideal"] = "ideal_to_measured"
    residuals: Literal["measured", "corrected"] = "measured"
    free: tuple[Intrinsic, ...] | None = None
    prior: bool = False
    sigma: dict[Intrinsic, Positive] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        own = {"focal_px", "focal_length_35mm", "aspect", "center_x_px", "center_y_px", "skew", "k1", "k2", "k3", "p1",
               "p2", "distortion_direction"} & self.model_fields_set  # fmt: skip
        if self.file is not None and own:
            raise ValueError(f"the file gives the camera, and so does {', '.join(sorted(own))}; leave one of both out")
        if self.focal_px is not None and self.focal_length_35mm is not None:
            raise ValueError("focal_px and focal_length_35mm say the same; leave one out")
        if self.prior and self.file is None:
            raise ValueError("prior = true weighs by the covariance of a camera file; give one, or use [camera.sigma]")
        strangers = [name for name in self.sigma if name not in self.estimated]
        if strangers:
            raise ValueError(f"sigma of {', '.join(strangers)}, which is held; name it in free")
        return self

    @property
    def is_known(self) -> bool:
        """Whether the file tells the lens, and not only what to start from."""
        return self.file is not None or self.focal_px is not None

    @property
    def estimated(self) -> tuple[Intrinsic, ...]:
        """Intrinsics that are estimated."""
        if self.free is not None:
            return self.free
        return () if self.is_known else SELF_CALIBRATED


class ImagePointsSection(Section):
    """Image points measured by another program, instead of photos."""

    file: Text = "image_points.csv"
    pixel_origin: Literal["center", "corner"] = "center"
    default_sigma_px: Positive = 0.1


class TargetsSection(Section):
    """Targets in the photos: ring codes (``aicon-12``, ``metashape-14``) or square markers (``DICT_4X4_100``)."""

    dictionary: Text
    diameter_mm: Positive | None = None
    polarity: Literal["black-on-white", "white-on-black", "both"] = "both"
    smallest_px: Annotated[float, Field(strict=True, ge=3)] = 6.0
    largest_px: Positive = 100.0


class ScaleBarSection(Section):
    """A known distance between two targets."""

    a: Text
    b: Text
    length_m: Positive
    sigma_mm: Positive
    check_only: bool = False


class PermissibleLengthErrorSection(Section):
    """Largest permissible length measurement error, ``a + L / k`` but at most b (VDI/VDE 2634 part 1)."""

    a_mm: Positive
    k: Annotated[float, Field(strict=True, gt=0)] = float("inf")
    b_mm: Annotated[float, Field(strict=True, gt=0)] = float("inf")


class ControlPointSection(Section):
    """A target with known coordinates; without sigma it is held."""

    target: Text
    xyz_m: Vector3
    sigma_mm: Sigma3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _all_or_none(self) -> Self:
        if 0.0 in self.sigma_mm and any(self.sigma_mm):
            raise ValueError("sigma_mm: give all three positive, or none for a point without error")
        return self


class CoordinateSection(Section):
    """A known coordinate of one target."""

    kind: Literal["coordinate"]
    target: Text
    axis: Literal["x", "y", "z"]
    value_m: Number
    sigma_mm: Positive


class DistanceSection(Section):
    """A known distance of two targets, as a scale bar."""

    kind: Literal["distance"]
    a: Text
    b: Text
    distance_m: Positive
    sigma_mm: Positive


class PlaneSection(Section):
    """Targets in one plane; without a normal the plane is unknown."""

    kind: Literal["plane"]
    targets: Annotated[tuple[Text, ...], Field(min_length=1)]
    sigma_mm: Positive
    normal: Vector3 | None = None
    offset_m: Number = 0.0


class StartSection(Section):
    """Start values that are known: coordinates of targets, poses of photos; an inner datum refers to the former."""

    points: Text | None = None
    cameras: Text | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The files that are named."""
        return tuple(name for name in (self.points, self.cameras) if name is not None)


class DatumSection(Section):
    """How position, rotation and scale are defined where constraints and control points leave them open."""

    kind: Literal["inner", "minimal"] = "inner"
    targets: tuple[Text, ...] = ()


class AdjustmentSection(Section):
    """How the network is adjusted."""

    reject: bool = True
    family_significance: Annotated[float, Field(strict=True, gt=0, lt=1)] = 0.05
    sigmas: Literal["stated", "from residuals"] | None = None


KnowledgeSection = Annotated[CoordinateSection | DistanceSection | PlaneSection, Discriminator("kind")]


class PhotogrammetryModel(Section):
    """The whole measurement.toml of ``kind = "photogrammetry"``."""

    kind: Literal["photogrammetry"]
    name: Text
    date: datetime.date | datetime.datetime | None = None
    notes: str = ""
    camera: NetworkCameraSection = NetworkCameraSection()
    images: PhotosSection | None = None
    image_points: ImagePointsSection | None = None
    targets: TargetsSection | None = None
    scale_bar: tuple[ScaleBarSection, ...] = ()
    permissible_length_error: PermissibleLengthErrorSection | None = None
    control_point: tuple[ControlPointSection, ...] = ()
    constraint: tuple[KnowledgeSection, ...] = ()
    start: StartSection | None = None
    datum: DatumSection = DatumSection()
    adjustment: AdjustmentSection = AdjustmentSection()

    @model_validator(mode="after")
    def _photos_or_points(self) -> Self:
        if (self.images is None) == (self.image_points is None):
            raise ValueError("give [images] with photos, or [image_points] with a file, one of both")
        if self.images is not None and self.targets is None:
            raise ValueError("[targets] is missing: say which dictionary the targets in the photos are from")
        if self.image_points is not None and self.camera.file is None and self.camera.width_px is None:
            raise ValueError("camera: width_px and height_px (or a file) are needed with image points")
        if (self.camera.width_px is None) != (self.camera.height_px is None):
            raise ValueError("camera: width_px and height_px belong together")
        return self
