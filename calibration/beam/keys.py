"""Keys of measurement.toml of ``kind = "beam"``, and folders of the PAINT database that need none."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heliogauge.errors import InputError
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import (
    Count,
    ImageFiles,
    Index,
    MeasurementModel,
    Names,
    Number,
    Positive,
    Section,
    Sigma,
    Text,
    Vector2,
    Vector3,
    repeated,
)

#: Files of records of the PAINT database: one for each beam.
PAINT_RECORDS = "*calibration*propert*.json"
Method = Literal["intensity", "threshold", "gaussian", "super_gaussian"]
Share = Annotated[float, Field(strict=True, gt=0, lt=1)]


class BeamImagesSection(Section):
    """How the photos of beams on one target are made: where the target is in them.

    One of these states where the target is: ``whole`` (the photo is the target: "edge" where its outer edges are
    the target's, "index" where its outermost pixels' centres are), ``corners_px`` (upper left, upper right, lower
    right, lower left), ``markers`` (four pictures of marks, in that order), ``aruco_ids`` with ``dictionary``,
    ``dark_marks``. ``corners_sigma_px`` is how well the given pixels are known: 0.3 is careful work by hand. ``empty``
    are photos of the target without a beam, ``camera`` a calibrated camera's file.
    """

    target: Text = Field(description="Name of the target in the photos.")
    whole: Literal["index", "edge"] | None = Field(
        None, description="The photo is the target: up to its edges (edge) or outermost pixel centres (index)."
    )
    corners_px: Annotated[tuple[Vector2, ...], Field(min_length=4, max_length=4)] | None = Field(
        None, description="Corners: upper left, upper right, lower right, lower left [px]."
    )
    corners_sigma_px: Positive = Field(0.3, description="1 sigma of those pixels; 0.3: careful work by hand [px].")
    markers: Annotated[Names, Field(min_length=4, max_length=4)] | None = Field(
        None, description="Pictures of the marks at the corners, in that order."
    )
    anchors_px: Annotated[tuple[Vector2, ...], Field(min_length=4, max_length=4)] | None = Field(
        None,
        description="The target's corner in each picture of markers, in that order; default: the outer corner of the "
        "mark. A mark that two targets share (T-shaped) has none: there they are needed [px].",
    )
    aruco_ids: Annotated[tuple[Index, ...], Field(min_length=4, max_length=4)] | None = Field(
        None, description="ArUco markers at the corners, in that order."
    )
    dictionary: Text = Field("DICT_4X4_50", description="OpenCV's dictionary of those markers.")
    dark_marks: Literal["outer", "inner"] | None = Field(
        None, description="Dark marks at the corners: which of their corners count."
    )
    empty: ImageFiles | None = Field(None, description="Photos without a beam: a text with * or a list.")
    camera: Text | None = Field(None, description="File of the calibrated camera, to correct its lens.")

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        keys = ("whole", "corners_px", "markers", "aruco_ids", "dark_marks")
        given = [key for key in keys if getattr(self, key) is not None]
        if len(given) != 1:
            said = " and ".join(given) or "nothing"
            raise ValueError(f"one of {', '.join(keys)} must state where the target is in the photos, not {said}")
        if self.anchors_px is not None and self.markers is None:
            raise ValueError("anchors_px are the target's corners in the pictures of markers, which are missing")
        return self


class BeamTargetSection(Section):
    """A flat target by its size, or by four corners measured on its plane."""

    name: Text = Field(description="Name of the target.")
    width_m: Positive | None = Field(None, description="Its width [m].")
    height_m: Positive | None = Field(None, description="Its height [m].")
    corners_m: Annotated[tuple[Vector2, ...], Field(min_length=4, max_length=4)] | None = Field(
        None, description="Instead: upper left, upper right, lower right, lower left; x right, y up on its plane [m]."
    )
    distance_m: Positive | None = Field(
        None, description="From the mirror's middle to the target's: turns metres into angles of the beam [m]."
    )
    center_m: Vector3 | None = Field(
        None, description="Its centre in the field, east, north, up; needed by `beam compare` [m]."
    )
    facing_azimuth_deg: Number | None = Field(None, description="Azimuth that it faces; 180: south [deg].")

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        given = [key for key in ("width_m", "height_m") if getattr(self, key) is not None]
        if self.corners_m is not None and given:
            raise ValueError(f"the corners define the target, and so does {given[0]}; leave one of both out")
        if (self.center_m is None) != (self.facing_azimuth_deg is None):
            raise ValueError("center_m and facing_azimuth_deg belong together: where the target stands in the field")
        if self.corners_m is None and len(given) < 2:
            raise ValueError("width_m and height_m are needed, or the four corners_m")
        return self


class BeamPhotosSection(Section):
    """The photos: files, a table with a row for each, or the frames of a video."""

    photos: ImageFiles | None = Field(None, description="Photos of beams: a text with * or a list.")
    table: Text | None = Field(
        None,
        description="CSV with a row for each photo: image; target, time_utc, distance_m, power_w, sigma_power_w, "
        "label_x_m, label_y_m, sun_azimuth_deg (0 north, clockwise), sun_elevation_deg where known; all other "
        "columns (drive readings) are passed on.",
    )
    video: Text | None = Field(None, description="A video of the beam; its frames are the photos.")
    every_nth: Count = Field(1, description="Of a video only every nth frame.")
    target: Text | None = Field(None, description="Target in all photos, if there is more than one [[target]].")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [key for key in ("photos", "table", "video") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                f"one of photos, table, video must say which photos there are, not {' and '.join(given) or 'none'}"
            )
        return self


class BeamFluxSection(Section):
    """What turns brightness into flux density: the power of the beam, or a calorimeter that it falls on."""

    power_w: Positive | None = Field(None, description="Power of each beam on the target [W].")
    sigma_power_w: Sigma = Field(0.0, description="Its standard deviation [W].")
    gauge_flux_w_m2: Positive | None = Field(
        None, description="Flux density that a calorimeter in the target reads [W/m2]."
    )
    sigma_gauge_flux_w_m2: Sigma = Field(0.0, description="Its standard deviation [W/m2].")
    gauge_center_m: Vector2 | None = Field(
        None, description="The calorimeter's centre on the target, x right, y up [m]."
    )
    gauge_diameter_m: Positive | None = Field(None, description="Diameter of its opening [m].")
    reflectance_map: Text | None = Field(
        None, description="Picture of the target's relative diffuse reflectance (grey values), its edges the target's."
    )

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        if self.power_w is not None and self.gauge_flux_w_m2 is not None:
            raise ValueError("power_w and gauge_flux_w_m2 both set the scale; leave one of both out")
        if self.gauge_flux_w_m2 is not None and (self.gauge_center_m is None or self.gauge_diameter_m is None):
            raise ValueError("gauge_center_m and gauge_diameter_m say where gauge_flux_w_m2 was read")
        return self


class BeamEvaluationSection(Section):
    """How beams are measured."""

    method: Method = Field("intensity", description="Method of the centre; intensity is recommended.")
    channel: Literal["red", "green", "blue", "luminance"] = Field("green", description="Colour that is measured.")
    contours: Annotated[tuple[Share, ...], Field(min_length=1)] = Field(
        (0.1, 0.25, 0.5, 0.75, 0.9), description="Contours of the flux, as shares of the peak."
    )


class BeamSiteSection(Section):
    """Where the mirror stands on Earth: for the sun at the times of the photos."""

    latitude_deg: Annotated[float, Field(strict=True, ge=-90, le=90)] = Field(
        description="Latitude, north positive [deg]."
    )
    longitude_deg: Annotated[float, Field(strict=True, ge=-180, le=360)] = Field(
        description="Longitude, east positive [deg]."
    )
    altitude_m: Number = Field(0.0, description="Height above sea level [m].")


class BeamFacetSection(Section):
    """A rectangular facet of a mirror as it is designed; frame of the mirror: x right, y up from the front, z out."""

    center_m: Vector3 = Field(description="Its middle [m].")
    width_m: Positive = Field(description="Size along x [m].")
    height_m: Positive = Field(description="Size along y [m].")
    focal_length_m: Positive | None = Field(None, description="Focal length; default: flat [m].")
    canting_mrad: Vector2 = Field((0.0, 0.0), description="Turn of its normal towards +x and +y [mrad].")


class BeamMirrorSection(Section):
    """The mirror that made the beams: for `beam compare`."""

    surface: Text | None = Field(
        None,
        description="Measured surface: slope_map.nc of heliogauge, a file of ARTIST (.h5, NURBS), or a CSV with x_m, "
        "y_m, z_m, slope_x, slope_y, area_m2 and facet.",
    )
    heliostat: Text | None = Field(None, description="Its name in a file of ARTIST.")
    facet: tuple[BeamFacetSection, ...] = Field((), description="Instead of a surface: its facets by design.")
    position_m: Vector3 | None = Field(None, description="Its middle in the field: east, north, up [m].")
    mount: Literal["azimuth-elevation", "east-axis"] | None = Field(
        None,
        description="How it turns: azimuth-elevation, or an axis to the east that carries one along its height (two "
        "linear actuators). Default: east-axis for PAINT and ARTIST, else azimuth-elevation.",
    )
    circumsolar_ratio: Annotated[float, Field(strict=True, ge=0, le=0.8)] | None = Field(
        None, description="Of the sun's shape by Buie; 0: the disc alone; default: estimated from each photo's skirts."
    )
    sun_file: Text | None = Field(
        None,
        description="Measured sun: columns angle_mrad, radiance, as of backward gazing; or a .sun of SolTrace.",
    )
    scatter_mrad: Sigma = Field(
        0.0, description="1 sigma of the beam's scatter in one direction beyond the surface [mrad]."
    )


class PaintBeamsSection(Section):
    """Records of the PAINT database: one JSON for each photo, and the tower's file."""

    folder: Text = Field(".", description="Folder with the records.")
    tower: Text | None = Field(None, description="The tower's file; default: here or in one of three folders above.")
    pictures: Literal["cropped", "flux"] = Field(
        "cropped", description="Which pictures: cropped (with background), or flux (background removed by the plant)."
    )


class BeamModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "beam"``."""

    kind: Literal["beam"] = Field(description="Photos of beams on targets.")
    target: tuple[BeamTargetSection, ...] = Field((), description="Targets of the beams, a table for each.")
    images: tuple[BeamImagesSection, ...] = Field(
        (), description="Where each target is in its photos, a table for each."
    )
    photos: BeamPhotosSection | None = Field(None, description="The photos.")
    paint: PaintBeamsSection | None = Field(None, description="Records of the PAINT database, instead of the above.")
    site: BeamSiteSection | None = Field(None, description="Where on Earth; for the sun from time_utc of the photos.")
    mirror: BeamMirrorSection = Field(BeamMirrorSection(), description="The mirror, for `beam compare`.")
    flux: BeamFluxSection = Field(BeamFluxSection(), description="What makes the flux absolute.")
    evaluation: BeamEvaluationSection = Field(BeamEvaluationSection(), description="How beams are measured.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.paint is not None:
            doubled = {"target", "images", "photos"} & self.model_fields_set
            if doubled:
                raise ValueError(f"[paint] names the data, and so does [{min(doubled)}]; leave one of both out")
            return self
        if self.photos is None or not self.target:
            raise ValueError("[photos] and [[target]] are needed: which photos there are, and how large the target is")
        names = [one.name for one in self.target]
        for kind, listed in (("target", names), ("images", [one.target for one in self.images])):
            if (twice := repeated(listed)) is not None:
                raise ValueError(f"{kind} {twice!r} is described twice; keep one")
        unknown = {one.target for one in self.images} - set(names)
        if unknown:
            raise ValueError(f"images: target {min(unknown)!r} is not among [[target]]: {', '.join(names)}")
        if self.photos.target is not None and self.photos.target not in names:
            raise ValueError(f"photos.target {self.photos.target!r} is not among [[target]]: {', '.join(names)}")
        if self.photos.table is None and self.photos.target is None and len(names) > 1:
            raise ValueError("photos.target must say which of the targets the photos show; or give a table")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class BeamsMeasurement:
    """Checked photos of beams: the content of measurement.toml, and where its files are.

    folder: The measurement's folder.
    model: The content of measurement.toml; for records of the PAINT database without one, all is default.
    has_file: Whether there is a measurement.toml.
    """

    folder: Path
    model: BeamModel
    has_file: bool = True

    def path(self, text: str) -> Path:
        """Return the path of a file named in measurement.toml."""
        return self.folder / text

    @property
    def input_files(self) -> tuple[Path, ...]:
        """Files that all photos share, measurement.toml first."""
        own = (self.folder / MEASUREMENT_FILE,) if self.has_file else ()
        photos, flux = self.model.photos, self.model.flux
        named = [] if photos is None else [photos.table, photos.video]
        cameras = [one.camera for one in self.model.images]
        return (
            *own,
            *(
                self.path(one)
                for one in (*named, flux.reflectance_map, *self._mirror_files, *cameras)
                if one is not None
            ),
        )

    @property
    def _mirror_files(self) -> tuple[str | None, ...]:
        return self.model.mirror.surface, self.model.mirror.sun_file

    @property
    def photo_files(self) -> tuple[Path, ...]:
        """Photos that a pattern or list names; empty where a table or a video does.

        InputError: None, or one that is not there.
        """
        photos = self.model.photos
        if photos is None or photos.photos is None:
            return ()
        return image_files(self.folder, "photos.photos", photos.photos)


def paint_beams(folder: Path) -> BeamsMeasurement | None:
    """Describe a folder with records of the PAINT database and their pictures that has no measurement.toml."""
    if (folder / MEASUREMENT_FILE).exists() or next(folder.glob(PAINT_RECORDS), None) is None:
        return None
    for pictures in ("cropped", "flux"):
        if next(folder.glob(f"*[-_]{pictures}.png"), None) is not None:
            paint = PaintBeamsSection(pictures=pictures)
            model = BeamModel(kind="beam", name=folder.resolve().name or "beams", paint=paint)
            return BeamsMeasurement(folder, model, has_file=False)
    return None


def load_beams(folder: Path) -> BeamsMeasurement:
    """Read and check a folder with photos of beams.

    folder: Folder with measurement.toml, or one with records of the PAINT database, which needs none.
    Returns: The measurement; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`; no photo; no place of a target in its photos.
    """
    found = paint_beams(folder)
    if found is None:
        file, model = read_measurement(folder, BeamModel)
        found = BeamsMeasurement(folder, model)
        refuse_missing(file, found.input_files)
        described = {one.target for one in model.images}
        missing = [one.name for one in model.target if one.name not in described]
        if missing:
            raise InputError(f"{file}: [[images]] must say where target {missing[0]!r} is in its photos")
    return found
