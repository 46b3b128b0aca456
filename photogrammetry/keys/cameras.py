"""Keys of a camera in measurement.toml."""

from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from heliogauge.measurement.models import (
    Count,
    Intrinsic,
    Number,
    Positive,
    Section,
    Sigma,
    SomeNames,
    Text,
    Vector2,
    Vector3,
)

#: Intrinsics of a camera of which nothing is known but its size.
SELF_CALIBRATED: tuple[Intrinsic, ...] = (
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
_PIXEL_KEYS = frozenset(
    {
        "focal_px",
        "focal_length_35mm",
        "aspect",
        "center_x_px",
        "center_y_px",
        "skew",
        "k1",
        "k2",
        "k3",
        "p1",
        "p2",
    }
)


class MillimetreSection(Section):
    """A camera as photogrammetric programs print it, in millimetres on the sensor."""

    form: Literal["brown", "aicon"] = Field(
        "brown", description="Formula of the lens: Brown's (DBAT, PhotoModeler) or AICON's."
    )
    focal_mm: Positive = Field(description="Camera constant [mm].")
    pixel_mm: Positive = Field(description="Height of a pixel on the sensor [mm].")
    principal_mm: Vector2 | None = Field(
        None, description="Principal point, x and y; default: the middle of the image [mm]."
    )
    principal_origin: Literal["center", "corner"] = Field(
        "center", description="Origin of the principal point: middle of the image, or corner of the first pixel."
    )
    y_axis: Literal["up", "down"] = Field("up", description="Direction of the y axis of the lens formulas.")
    radial: Vector3 = Field((0.0, 0.0, 0.0), description="Radial coefficients, in powers of 1/mm.")
    tangential: Vector2 = Field((0.0, 0.0), description="Tangential coefficients, in powers of 1/mm.")
    affine: Vector2 = Field((0.0, 0.0), description="Aspect and shear.")
    zero_radius_mm: Sigma = Field(0.0, description="Radius at which AICON's radial distortion is zero [mm].")

    @model_validator(mode="after")
    def _radius_of_aicon(self) -> Self:
        if self.zero_radius_mm and self.form != "aicon":
            raise ValueError('zero_radius_mm belongs to form = "aicon"')
        return self


class NetworkCameraSection(Section):
    """A camera: a file or start values, which intrinsics are estimated, and which photos it took.

    Without a file and without a focal length the camera calibrates itself. A known camera is held unless ``free`` names
    intrinsics; ``prior = true`` weighs them by the covariance of the file, ``sigma`` by single sigmas.
    """

    name: Text = Field("camera", description="Name of the camera in cameras.json.")
    photos: SomeNames | None = Field(None, description="Patterns of the photos it took; default: the rest.")
    file: Text | None = Field(None, description="File of a calibrated camera.")
    width_px: Count | None = Field(None, description="Width of the photos; needed with image points [px].")
    height_px: Count | None = Field(None, description="Height of the photos [px].")
    focal_px: Positive | None = Field(
        None, description="Focal length over pixel pitch: known, unless free names it [px]."
    )
    focal_length_35mm: Positive | None = Field(
        None, description="Focal length for 36 mm x 24 mm film, as a start [mm]."
    )
    aspect: Number = Field(0.0, description="Ratio of the focal lengths along rows and columns, minus 1.")
    center_x_px: Number | None = Field(None, description="Principal point, x; default: the middle of the image [px].")
    center_y_px: Number | None = Field(None, description="Principal point, y; default: the middle of the image [px].")
    skew: Number = Field(0.0, description="Skew of the image axes: columns that a unit of y/z adds [px].")
    k1: Number = Field(0.0, description="Radial distortion, second power (Brown, normalised coordinates).")
    k2: Number = Field(0.0, description="Radial distortion, fourth power.")
    k3: Number = Field(0.0, description="Radial distortion, sixth power.")
    p1: Number = Field(0.0, description="Tangential distortion, first coefficient.")
    p2: Number = Field(0.0, description="Tangential distortion, second coefficient.")
    millimetres: MillimetreSection | None = Field(
        None, description="The camera as photogrammetric programs print it, in millimetres on the sensor."
    )
    distortion_direction: Literal["ideal_to_measured", "measured_to_ideal"] | None = Field(
        None, description="What the lens's terms are added to; default: ideal_to_measured. Needed with millimetres."
    )
    residuals: Literal["measured", "corrected"] = Field(
        "measured", description="Where residuals are formed: in the measured image, or corrected for the lens (DBAT)."
    )
    free: tuple[Intrinsic, ...] | None = Field(
        None, description="Intrinsics that are estimated; default: none if known, else all but skew; [] for none."
    )
    prior: bool = Field(False, description="Weigh what is free by the covariance of the file.")
    sigma: dict[Intrinsic, Positive] = Field(
        default_factory=dict, description="Standard deviations of start values of those in free."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        own = _PIXEL_KEYS & self.model_fields_set
        lens = own | ({"distortion_direction"} & self.model_fields_set)
        if self.file is not None and lens:
            raise ValueError(f"the file gives the camera, and so does {', '.join(sorted(lens))}; leave one of both out")
        if self.file is not None and self.millimetres is not None:
            raise ValueError("the file gives the camera, and so does [camera.millimetres]; leave one of both out")
        if self.millimetres is not None and own:
            raise ValueError(
                f"[camera.millimetres] gives the camera, and so does {', '.join(sorted(own))}; leave one of both out"
            )
        if self.millimetres is not None and self.distortion_direction is None:
            raise ValueError(
                'distortion_direction is needed with [camera.millimetres]: "measured_to_ideal" where its formula '
                "corrects measured points (PhotoModeler, DBAT's backward models, Australis, iWitness), "
                '"ideal_to_measured" where it is applied to ideal ones (AICON, Metashape); of the right one the '
                "residuals are smaller"
            )
        if self.focal_px is not None and self.focal_length_35mm is not None:
            raise ValueError("focal_px and focal_length_35mm say the same; leave one out")
        if self.prior and self.file is None:
            raise ValueError("prior = true weighs by the covariance of a camera file; give one, or use [camera.sigma]")
        if (self.width_px is None) != (self.height_px is None):
            raise ValueError("width_px and height_px belong together")
        strangers = [name for name in self.sigma if name not in self.estimated]
        if strangers:
            raise ValueError(f"sigma of {', '.join(strangers)}, which is held; name it in free")
        return self

    @property
    def is_known(self) -> bool:
        """Whether the file states the lens, and not only what to start from."""
        return self.file is not None or self.focal_px is not None or self.millimetres is not None

    @property
    def has_size(self) -> bool:
        """Whether the file states the size of the image."""
        return self.file is not None or self.width_px is not None

    @property
    def estimated(self) -> tuple[Intrinsic, ...]:
        """Intrinsics that are estimated."""
        if self.free is not None:
            return self.free
        return () if self.is_known else SELF_CALIBRATED

    def took(self, photo: str) -> bool:
        """Whether the patterns name a photo, by its name or its path in the folder, as ``[images] photos`` does."""
        return any(PurePosixPath(photo).match(pattern) for pattern in self.photos or ())


def _as_list(value: Any) -> Any:
    return (value,) if isinstance(value, dict | NetworkCameraSection) else value


def _checked_together(cameras: tuple[NetworkCameraSection, ...]) -> tuple[NetworkCameraSection, ...]:
    names = [one.name for one in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"{names.count(twice)} cameras are called {twice!r}; give each its own name")
    rest = [one.name for one in cameras if one.photos is None]
    if len(rest) > 1:
        raise ValueError(f"say which photos {', '.join(rest)} took, photos = [...]; one camera may take the rest")
    return cameras


#: ``[camera]``, or ``[[camera]]`` for each of several.
CameraSections = Annotated[
    tuple[NetworkCameraSection, ...],
    BeforeValidator(_as_list),
    Field(min_length=1),
    AfterValidator(_checked_together),
]


def camera_of_photos(cameras: Sequence[NetworkCameraSection], photos: Sequence[str]) -> tuple[int, ...]:
    """Say which camera took each photo.

    photos: Names of the photos, or their paths in the measurement's folder.
    ValueError: A photo of no camera or of several; the message names it.
    """
    rest = next((place for place, one in enumerate(cameras) if one.photos is None), None)
    result = []
    for photo in photos:
        own = [place for place, one in enumerate(cameras) if one.took(photo)]
        if len(own) > 1:
            raise ValueError(f"photo {photo} is named by {' and '.join(cameras[place].name for place in own)}")
        if not own and rest is None:
            raise ValueError(f"photo {photo} is of no camera; leave photos out of one [[camera]] that takes the rest")
        result.append(own[0] if own else int(rest or 0))
    return tuple(result)
