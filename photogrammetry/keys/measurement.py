"""What measurement.toml of ``kind = "photogrammetry"`` may say."""

from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, model_validator

from heliogauge.measurement.models import (
    MeasurementModel,
    Number,
    PhotosSection,
    Positive,
    Section,
    Sigma3,
    Text,
    Vector3,
)
from photogrammetry.keys.cameras import CameraSections, NetworkCameraSection
from photogrammetry.keys.natural import NaturalSection
from photogrammetry.keys.surface import SurfaceSection
from photogrammetry.keys.targets import TargetsSection


class ImagePointsSection(Section):
    """Image points measured by another program, instead of photos."""

    file: Text = "image_points.csv"
    pixel_origin: Literal["center", "corner"] = "center"
    default_sigma_px: Positive = 0.1


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


class KnownFilesSection(Section):
    """Tables of what is known, instead of or besides the sections in the file; `photogrammetry.keys.known_files`."""

    control_points: Text | None = None
    scale_bars: Text | None = None
    coordinates: Text | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The files that are named."""
        return tuple(name for name in (self.control_points, self.scale_bars, self.coordinates) if name is not None)


class CollectorSection(Section):
    """Targets on the rim of a parabolic trough; y along the trough, z out of the mirror from its vertex line.

    Rim targets have x = -w/2 (left) or w/2 (right) and z = w^2 / (16 f); the targets of one end have y = 0; each pair
    in ``along`` is ``length_m`` apart.
    """

    width_m: Positive
    focal_length_m: Positive
    left: Annotated[tuple[Text, ...], Field(min_length=2)]
    right: Annotated[tuple[Text, ...], Field(min_length=2)]
    end: Annotated[tuple[Text, ...], Field(min_length=1)]
    along: tuple[tuple[Text, Text], ...] = ()
    length_m: Positive | None = None
    sigma_mm: Positive
    length_sigma_mm: Positive | None = None

    @model_validator(mode="after")
    def _length_and_pairs(self) -> Self:
        if bool(self.along) != (self.length_m is not None):
            raise ValueError("along and length_m belong together")
        both = sorted(set(self.left) & set(self.right))
        if both:
            raise ValueError(f"target {both[0]} cannot be on both sides")
        return self

    @property
    def rim_height_m(self) -> float:
        """Height of the rim over the vertex line [m]."""
        return self.width_m**2 / (16 * self.focal_length_m)


class DatumSection(Section):
    """How position, rotation and scale are defined where constraints and control points leave them open."""

    kind: Literal["inner", "minimal", "photos", "control"] = "inner"
    targets: tuple[Text, ...] = ()
    photos: tuple[Text, ...] = ()

    @model_validator(mode="after")
    def _fitting_names(self) -> Self:
        if self.kind == "photos" and not 1 <= len(set(self.photos)) <= 2:
            raise ValueError("photos: one photo that stays where it is, and one more if there is no scale")
        if self.photos and self.kind != "photos":
            raise ValueError(f'photos belongs to kind = "photos", not to "{self.kind}"')
        if self.targets and self.kind in {"photos", "control"}:
            raise ValueError(f'targets belongs to kind = "inner" or "minimal", not to "{self.kind}"')
        return self


class AdjustmentSection(Section):
    """How the network is adjusted."""

    reject: bool = True
    family_significance: Annotated[float, Field(strict=True, gt=0, lt=1)] = 0.05
    sigmas: Literal["stated", "from residuals"] | None = None


KnowledgeSection = Annotated[CoordinateSection | DistanceSection | PlaneSection, Discriminator("kind")]


class PhotogrammetryModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "photogrammetry"``."""

    kind: Literal["photogrammetry"]
    camera: CameraSections = (NetworkCameraSection(),)
    images: PhotosSection | None = None
    image_points: ImagePointsSection | None = None
    targets: TargetsSection | None = None
    natural: NaturalSection | None = None
    scale_bar: tuple[ScaleBarSection, ...] = ()
    permissible_length_error: PermissibleLengthErrorSection | None = None
    control_point: tuple[ControlPointSection, ...] = ()
    constraint: tuple[KnowledgeSection, ...] = ()
    start: StartSection | None = None
    files: KnownFilesSection = KnownFilesSection()
    collector: CollectorSection | None = None
    datum: DatumSection = DatumSection()
    adjustment: AdjustmentSection = AdjustmentSection()
    surface: SurfaceSection | None = None

    @model_validator(mode="after")
    def _photos_or_points(self) -> Self:
        if (self.images is None) == (self.image_points is None):
            raise ValueError("give [images] with photos, or [image_points] with a file, one of both")
        if self.images is not None and self.targets is None and self.natural is None:
            raise ValueError(
                "[targets] is missing: say which dictionary the targets in the photos are from; or [natural] for "
                "photos without targets"
            )
        if self.natural is not None and self.images is None:
            raise ValueError("[natural] is for photos; image points are measured already")
        if self.natural is not None and self.adjustment.sigmas == "stated":
            raise ValueError('adjustment.sigmas = "stated": natural features have none; leave it out')
        unsized = [one.name for one in self.camera if not one.has_size]
        if self.image_points is not None and unsized:
            raise ValueError(f"{', '.join(unsized)}: width_px and height_px (or a file) are needed with image points")
        return self
