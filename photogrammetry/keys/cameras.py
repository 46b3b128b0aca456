"""What measurement.toml of ``kind = "photogrammetry"`` may say of a camera."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from heliogauge.measurement.models import Count, Intrinsic, Number, Positive, Section, Sigma, Text, Vector2, Vector3

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
    """A camera as photogrammetric programs print it, in millimetres on the sensor.

    ``form = "brown"``: radial K1 to K3, tangential P1, P2, affine aspect and shear (DBAT, PhotoModeler);
    ``form = "aicon"``: A1 to A3 with ``zero_radius_mm``, B1, B2, C1, C2. The formulas are those of
    `heliogauge.camera.millimetres`.
    """

    form: Literal["brown", "aicon"] = "brown"
    focal_mm: Positive
    pixel_mm: Positive
    principal_mm: Vector2 | None = None
    principal_origin: Literal["center", "corner"] = "center"
    y_axis: Literal["up", "down"] = "up"
    radial: Vector3 = (0.0, 0.0, 0.0)
    tangential: Vector2 = (0.0, 0.0)
    affine: Vector2 = (0.0, 0.0)
    zero_radius_mm: Sigma = 0.0

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

    name: Text = "camera"
    photos: Annotated[tuple[Text, ...], Field(min_length=1)] | None = None
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
    millimetres: MillimetreSection | None = None
    distortion_direction: Literal["ideal_to_measured", "measured_to_ideal"] | None = None
    residuals: Literal["measured", "corrected"] = "measured"
    free: tuple[Intrinsic, ...] | None = None
    prior: bool = False
    sigma: dict[Intrinsic, Positive] = Field(default_factory=dict)

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
        """Whether the file tells the lens, and not only what to start from."""
        return self.file is not None or self.focal_px is not None or self.millimetres is not None

    @property
    def has_size(self) -> bool:
        """Whether the file tells the size of the image."""
        return self.file is not None or self.width_px is not None

    @property
    def estimated(self) -> tuple[Intrinsic, ...]:
        """Intrinsics that are estimated."""
        if self.free is not None:
            return self.free
        return () if self.is_known else SELF_CALIBRATED

    def took(self, photo: str) -> bool:
        """Whether the patterns name a photo."""
        return any(fnmatchcase(photo, pattern) for pattern in self.photos or ())


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
