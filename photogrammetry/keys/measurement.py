"""Keys of measurement.toml of ``kind = "photogrammetry"``."""

from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, model_validator

from heliogauge.measurement.models import (
    MeasurementModel,
    Names,
    Number,
    PhotosSection,
    Positive,
    Section,
    Sigma3,
    SomeNames,
    Text,
    Vector3,
)
from photogrammetry.keys.cameras import CameraSections, NetworkCameraSection
from photogrammetry.keys.natural import NaturalSection
from photogrammetry.keys.positions import PositionsSection
from photogrammetry.keys.surface import SurfaceSection
from photogrammetry.keys.targets import TargetsSection


class ImagePointsSection(Section):
    """Image points measured by another program, instead of photos."""

    file: Text = Field(
        "image_points.csv", description="Columns image, target, x_px, y_px, perhaps sigma_x_px, sigma_y_px."
    )
    pixel_origin: Literal["center", "corner"] = Field(
        "center", description="Where (0, 0) is: centre, or outer corner of the top-left pixel (DBAT, COLMAP)."
    )
    default_sigma_px: Positive = Field(0.1, description="1 sigma of coordinates where the table has none [px].")


class ScaleBarSection(Section):
    """A known distance between two targets."""

    a: Text = Field(description="Target at one end.")
    b: Text = Field(description="Target at the other end.")
    length_m: Positive = Field(description="Distance of the two targets [m].")
    sigma_mm: Positive = Field(description="Its standard deviation [mm].")
    check_only: bool = Field(False, description="Keep it out of the adjustment, as a test of the result.")


class PermissibleLengthErrorSection(Section):
    """Largest permissible length measurement error, ``a + L / k`` but at most b (VDI/VDE 2634 part 1)."""

    a_mm: Positive = Field(description="The part that does not depend on the length [mm].")
    k: Annotated[float, Field(strict=True, gt=0)] = Field(
        float("inf"), description="Length over added error: 100000 is 0.01 mm for a metre."
    )
    b_mm: Annotated[float, Field(strict=True, gt=0)] = Field(
        float("inf"), description="Limit that it never exceeds [mm]."
    )


class ControlPointSection(Section):
    """A target with known coordinates; without sigma it is held."""

    target: Text = Field(description="Name of the target.")
    xyz_m: Vector3 = Field(description="Its known coordinates [m].")
    sigma_mm: Sigma3 = Field(
        (0.0, 0.0, 0.0), description="1 sigma of each coordinate; one number stands for three; 0: held [mm]."
    )

    @model_validator(mode="after")
    def _all_or_none(self) -> Self:
        if 0.0 in self.sigma_mm and any(self.sigma_mm):
            raise ValueError("sigma_mm: give all three positive, or none for a point without error")
        return self


class CoordinateSection(Section):
    """A known coordinate of one target."""

    kind: Literal["coordinate"] = Field(description="A known coordinate of one target.")
    target: Text = Field(description="Name of the target.")
    axis: Literal["x", "y", "z"] = Field(description="Which coordinate.")
    value_m: Number = Field(description="Its value [m].")
    sigma_mm: Positive = Field(description="Its standard deviation [mm].")


class DistanceSection(Section):
    """A known distance of two targets, as a scale bar."""

    kind: Literal["distance"] = Field(description="A known distance of two targets.")
    a: Text = Field(description="One target.")
    b: Text = Field(description="The other target.")
    distance_m: Positive = Field(description="Their distance [m].")
    sigma_mm: Positive = Field(description="Its standard deviation [mm].")


class PlaneSection(Section):
    """Targets in one plane; without a normal the plane is unknown."""

    kind: Literal["plane"] = Field(description="Targets in one plane.")
    targets: SomeNames = Field(description="Names of the targets.")
    sigma_mm: Positive = Field(description="Standard deviation of their distances from the plane [mm].")
    normal: Vector3 | None = Field(None, description="Normal of a known plane; default: estimated.")
    offset_m: Number = Field(0.0, description="Distance of a known plane from the origin [m].")


class StartSection(Section):
    """Start values that are known: coordinates of targets, poses of photos; an inner datum refers to the former."""

    points: Text | None = Field(
        None, description="points.csv with start coordinates of targets; an inner datum refers to them."
    )
    cameras: Text | None = Field(None, description="cameras.json with start poses of the photos.")

    @property
    def names(self) -> tuple[str, ...]:
        """The files that are named."""
        return tuple(name for name in (self.points, self.cameras) if name is not None)


class KnownFilesSection(Section):
    """Tables of what is known, instead of or besides the sections in the file; `photogrammetry.keys.known_files`."""

    control_points: Text | None = Field(
        None, description="Control points: columns target, x_m, y_m, z_m, perhaps sigma_x_mm and so on."
    )
    scale_bars: Text | None = Field(
        None, description="Scale bars: columns a, b, length_m, sigma_mm, perhaps check_only."
    )
    coordinates: Text | None = Field(None, description="Coordinates: columns target, axis, value_m, sigma_mm.")

    @property
    def names(self) -> tuple[str, ...]:
        """The files that are named."""
        return tuple(name for name in (self.control_points, self.scale_bars, self.coordinates) if name is not None)


class CollectorSection(Section):
    """Targets on the rim of a parabolic trough; y along the trough, z out of the mirror from its vertex line.

    Rim targets have x = -w/2 (left) or w/2 (right) and z = w^2 / (16 f); the targets of one end have y = 0; each pair
    in ``along`` is ``length_m`` apart.
    """

    width_m: Positive = Field(description="Width of the aperture between the rims' targets [m].")
    focal_length_m: Positive = Field(description="Focal length of the parabola [m].")
    left: Annotated[Names, Field(min_length=2)] = Field(description="Targets on the rim at x = -width / 2.")
    right: Annotated[Names, Field(min_length=2)] = Field(description="Targets on the rim at x = +width / 2.")
    end: SomeNames = Field(description="Targets of the end at y = 0.")
    along: tuple[tuple[Text, Text], ...] = Field((), description="Pairs of targets that are length_m apart along y.")
    length_m: Positive | None = Field(None, description="Distance of those pairs along y [m].")
    sigma_mm: Positive = Field(description="Standard deviation of the known coordinates [mm].")
    length_sigma_mm: Positive | None = Field(None, description="1 sigma of that distance; default: sigma_mm [mm].")

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

    kind: Literal["inner", "minimal", "photos", "control"] = Field(
        "inner", description="What places the network: inner constraints, three targets, photos that stay; or nothing."
    )
    targets: Names = Field((), description="Targets that take part; default: all.")
    photos: Names = Field((), description="Photos that stay: one, and one more without a scale.")

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

    reject: bool = Field(True, description="Leave out image points that contradict the others.")
    family_significance: Annotated[float, Field(strict=True, gt=0, lt=1)] = Field(
        0.05, description="Probability of leaving out any good point of all."
    )
    sigmas: Literal["stated", "from residuals"] | None = Field(
        None, description="Sigmas of image points; default: from residuals for photos, stated for tables."
    )


KnowledgeSection = Annotated[CoordinateSection | DistanceSection | PlaneSection, Discriminator("kind")]


class PhotogrammetryModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "photogrammetry"``."""

    kind: Literal["photogrammetry"] = Field(description="Photos, or image points, of targets.")
    camera: CameraSections = Field(
        (NetworkCameraSection(),), description="The camera, or a table for each; default: self-calibration."
    )
    images: PhotosSection | None = Field(None, description="The photos.")
    image_points: ImagePointsSection | None = Field(
        None, description="Image points of another program, instead of photos."
    )
    targets: TargetsSection | None = Field(None, description="The targets in the photos.")
    natural: NaturalSection | None = Field(
        None, description="Features of the surface itself; needs pip install heliogauge[natural]."
    )
    scale_bar: tuple[ScaleBarSection, ...] = Field((), description="Known distances between targets.")
    permissible_length_error: PermissibleLengthErrorSection | None = Field(
        None, description="Largest permissible length error a + L / k, at most b (VDI/VDE 2634)."
    )
    control_point: tuple[ControlPointSection, ...] = Field((), description="Targets with known coordinates.")
    constraint: tuple[KnowledgeSection, ...] = Field((), description="Known coordinates, distances and planes.")
    start: StartSection | None = Field(
        None, description="Start values from an earlier result; default: from the image points alone."
    )
    files: KnownFilesSection = Field(
        KnownFilesSection(), description="Tables of what is known, besides the sections here."
    )
    positions: PositionsSection | None = Field(
        None, description="The drone's own positions, which check the size of the network."
    )
    collector: CollectorSection | None = Field(None, description="Targets on the rim of a parabolic trough.")
    datum: DatumSection = Field(DatumSection(), description="What places the network where the rest leaves it open.")
    adjustment: AdjustmentSection = Field(AdjustmentSection(), description="How the network is adjusted.")
    surface: SurfaceSection | None = Field(None, description="The surface under the targets: fit, slope map, canting.")

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
        if self.positions is not None and self.positions.file is None and self.images is None:
            raise ValueError("positions.file is needed with image points: there are no photos to read positions from")
        unsized = [one.name for one in self.camera if not one.has_size]
        if self.image_points is not None and unsized:
            raise ValueError(f"{', '.join(unsized)}: width_px and height_px (or a file) are needed with image points")
        return self
