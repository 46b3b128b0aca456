"""What measurement.toml of ``kind = "observer"`` may say."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from heliogauge.doubts import Doubt
from heliogauge.images.video_names import video_of
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import (
    ImageFiles,
    MeasurementModel,
    Names,
    Number,
    Positive,
    Section,
    Sigma,
    Text,
    repeated,
)
from photogrammetry.keys import (
    CameraSections,
    DistanceSection,
    NetworkCameraSection,
    PositionsSection,
    ScaleBarSection,
    TargetsSection,
)

#: Largest distance of the nodes of a map [mm]; 20 mm is usual.
_LARGEST_STEP_MM = 500.0


class TroughSection(Section):
    """The collector module: lengths of mirror, absorber and glass; edges of the panels; receiver supports."""

    aperture_width_m: Positive = Field(description="Width of the aperture, across the trough [m].")
    length_m: Positive = Field(description="Length of the module [m].")
    focal_length_m: Positive = Field(description="Focal length of the parabola [m].")
    absorber_diameter_mm: Positive = Field(description="Diameter of the absorber tube [mm].")
    glass_outer_diameter_mm: Positive | None = Field(
        None, description="Outer diameter of the glass tube; default: no glass [mm]."
    )
    glass_inner_diameter_mm: Positive | None = Field(None, description="Inner diameter of the glass tube [mm].")
    glass_index: Annotated[float, Field(strict=True, ge=1, lt=3)] = Field(
        1.47, description="Refractive index of the glass."
    )
    panel_edges_x_m: tuple[Number, ...] = Field(
        (), description="Edges of the panels across the trough, outer ones too; default: one panel [m]."
    )
    panel_edges_y_m: tuple[Number, ...] = Field(
        (), description="Edges of the panels along the trough, outer ones too; default: one panel [m]."
    )
    panel_gap_mm: Sigma = Field(0.0, description="Width of the gaps between panels [mm].")
    panel_height_sigma_mm: Sigma = Field(
        0.8, description="Error of each panel's mean height, 1 sigma; less where it was measured [mm]."
    )
    support_y_m: tuple[Number, ...] = Field((), description="Places of the receiver supports along the trough [m].")
    support_width_m: Positive = Field(0.3, description="Width of a support along the trough [m].")
    orientation_deg: Number = Field(0.0, description="Turn from the zenith, right-handed about +y [deg].")

    @model_validator(mode="after")
    def _whole_glass(self) -> Self:
        if (self.glass_outer_diameter_mm is None) != (self.glass_inner_diameter_mm is None):
            raise ValueError("glass_outer_diameter_mm and glass_inner_diameter_mm belong together")
        return self


class ModuleSection(Section):
    """One of several collectors in the same photos: where it is, what targets it has, how it differs from the others.

    ``place_m`` is its origin in the frame of the common list of targets, ``turn_deg`` its turn there by the right
    hand about +y; with a list of its own, which is in its own frame, they are for pictures only. Without marked
    targets that frame is level: across, along (``azimuth_deg``) and up, and ``place_m`` is good to half a panel.
    """

    name: Text = Field(description="Name of the module; its results get a folder of this name.")
    place_m: tuple[Number, Number, Number] = Field(
        (0.0, 0.0, 0.0), description="Its origin in the frame that all modules have in common [m]."
    )
    loop: Text | None = Field(None, description="Loop that it belongs to; the overview has numbers for each loop.")
    turn_deg: Number = Field(0.0, description="Its turn in that frame, right-handed about +y [deg].")
    targets_file: Text | None = Field(None, description="A list of targets of its own, in its own frame.")
    collector: TroughSection | None = Field(None, description="Where it is built otherwise: all keys of [collector].")

    @field_validator("name")
    @classmethod
    def _folder_name(cls, name: str) -> str:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name):
            raise ValueError("letters, digits, - and _ are needed: the module's results get a folder of this name")
        return name


class PassSection(Section):
    """Photos of one or several passes, or a video."""

    photos: ImageFiles | None = Field(
        None, description="Photos of the passes: a text with * (natural order) or a list."
    )
    video: Text | None = Field(None, description="A video of the pass, instead of photos.")
    encoding: Literal["auto", "linear", "srgb"] = Field(
        "auto", description="Numbers proportional to light, or stretched for the eye (srgb); auto: from the photos."
    )
    every_nth: Annotated[int, Field(strict=True, ge=1)] = Field(
        1, description="Which of the video's frames are used: every n-th."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.photos is None) == (self.video is None):
            raise ValueError("give photos or a video, one of both")
        if self.video is None and self.every_nth != 1:
            raise ValueError("every_nth belongs to a video")
        return self


class KnownTargetsSection(TargetsSection):
    """Targets in the photos, and the table of their coordinates on the collector."""

    file: Text = Field(
        "targets.csv", description="Columns target, x_m, y_m, z_m, sigma_x_mm and so on; empty cell: not known."
    )


class CornersSection(Section):
    """Corners of the mirror panels as natural targets, for photos without marked ones.

    They need the panels' edges and gaps of ``[collector]``, and ``[positions]``, or the ``[tilts]`` of a collector that
    turns before a fixed camera. The camera's turns beside its positions are not needed; they save time.
    """

    azimuth_deg: Number | None = Field(
        None, description="Direction of +y, along the trough: clockwise from north; needed with [positions] [deg]."
    )
    turn_sigma_deg: Positive = Field(
        2.0, description="Error of the camera's turns and of azimuth and orientation together, 1 sigma [deg]."
    )
    mounting_sigma_mm: Positive = Field(
        3.0, description="How far panels lie off their places, across and along the trough, 1 sigma [mm]."
    )
    corner_sigma_mm: Positive = Field(
        1.0, description="How far each corner of a panel is off besides, in any direction, 1 sigma [mm]."
    )
    alike_sigma_mm: Sigma | None = Field(
        None,
        description="How far corners of one x are off in height together, as a shape that all rows of panels share "
        "makes it; default: corner_sigma_mm, 1 sigma [mm].",
    )


class TiltsSection(Section):
    """Readings of an inclinometer on a collector that turns before one fixed camera (TARMES).

    The camera stands where ``facing_deg`` is read when the collector faces it, ``distance_m`` from the axis about
    which the collector turns. Readings grow with the collector's turn by the right hand about +y.
    """

    file: Text = Field(
        "tilts.csv", description="Columns image, tilt_deg; or time, tilt_deg, times as in the photos' EXIF; sigma_mrad."
    )
    column: Names = Field(
        ("tilt_deg",), description="Columns of the readings [deg]; several: their mean, as of sensors at both ends."
    )
    time_column: str | None = Field(
        None,
        max_length=200,
        description="Column of times, instead of image: 2026-05-04 10:31:07, in the clock of the camera.",
    )
    time_offset_s: Number = Field(0.0, description="Clock of the camera less that of the table [s].")
    left_handed: bool = Field(False, description="Whether readings grow with a turn by the left hand about +y.")
    sigma_mrad: Positive = Field(description="Error of a reading against the others, 1 sigma [mrad].")
    distance_m: Positive = Field(description="From the collector's axis of rotation to the camera [m].")
    distance_sigma_m: Positive = Field(0.5, description="Its error, 1 sigma [m].")
    facing_deg: Number | None = Field(
        None, description="Reading when the collector faces the camera; default: middle of the readings [deg]."
    )
    facing_sigma_deg: Positive = Field(2.0, description="Its error, 1 sigma [deg].")
    along_m: Number = Field(0.0, description="Place of the camera along the trough [m].")
    along_sigma_m: Positive = Field(1.0, description="Its error, 1 sigma [m].")
    axis_m: tuple[Number, Number] = Field(
        (0.0, 0.0), description="The axis of rotation in the frame of the trough, x and z [m]."
    )
    axis_sigma_mm: Positive = Field(100.0, description="Its error, 1 sigma [mm].")
    scale_sigma: Positive = Field(0.01, description="Error of the readings' scale, 1 sigma.")
    camera_roll_deg: Number = Field(
        0.0, description="Turn of the upright camera about its line of sight, clockwise; 90: held upright [deg]."
    )


class AbsorberSection(Section):
    """How the absorber's position is found: from the same photos, from photos of its own, from a table, or assumed."""

    source: Literal["photos", "file", "design"] = Field("photos", description="Where its position comes from.")
    photos: ImageFiles | None = Field(None, description="Photos for the absorber alone; default: those of the pass.")
    file: Text | None = Field(None, description="Columns y_m, x_a_m, z_a_m, sigma_x_a_m, sigma_z_a_m.")
    station_step_m: Positive = Field(0.25, description="Distance of its places along the trough [m].")

    @model_validator(mode="after")
    def _fitting_source(self) -> Self:
        if (self.file is not None) != (self.source == "file"):
            raise ValueError('file belongs to source = "file" (columns y_m, x_a_m, z_a_m, sigma_x_a_m, sigma_z_a_m)')
        if self.photos is not None and self.source != "photos":
            raise ValueError('photos belongs to source = "photos"')
        return self


class SunSection(Section):
    """Sun shape for the intercept factor."""

    shape: Literal["gaussian", "pillbox", "buie", "table"] = Field(
        "gaussian", description="Shape of the sun for the intercept factor."
    )
    sigma_mrad: Positive = Field(2.73, description="Standard deviation of a Gaussian sun in one direction [mrad].")
    half_angle_mrad: Positive = Field(4.65, description="Half angle of a pillbox sun [mrad].")
    circumsolar_ratio: Annotated[float, Field(strict=True, ge=0, le=0.7)] = Field(
        0.05, description="Share of circumsolar radiation of a Buie sun."
    )
    file: Text | None = Field(
        None, description="Table of a measured sun: columns angle_mrad, radiance; or a .sun of SolTrace."
    )

    @model_validator(mode="after")
    def _table_has_file(self) -> Self:
        if (self.file is not None) != (self.shape == "table"):
            raise ValueError('file belongs to shape = "table" (columns angle_mrad, radiance)')
        return self


class OpticsSection(Section):
    """What else spreads the beam: specularity and tracking error, standard deviations of the reflected beam."""

    specularity_mrad: Sigma = Field(
        0.0, description="Spread by the surface: 1 sigma of the reflected beam, one direction [mrad]."
    )
    tracking_error_mrad: Sigma = Field(
        0.0, description="Standard deviation of the collector's rotation about its length [mrad]."
    )


class ObserverEvaluationSection(Section):
    """How the map is made."""

    row_step_mm: Positive = Field(20.0, description="Distance of the rows of the map, along the trough [mm].")
    column_step_mm: Positive = Field(20.0, description="Distance of the columns of the map, across the trough [mm].")
    largest_slope_error_mrad: Positive = Field(12.0, description="Largest slope error that is looked for [mrad].")
    longitudinal_slope_mrad: Positive = Field(
        2.0, description="1 sigma of slopes along the trough, if not measured [mrad]."
    )
    shape_from_slopes: bool | None = Field(
        None, description="Lines of sight meet the mirror as measured, or its design; default: from the photos."
    )

    @field_validator("row_step_mm", "column_step_mm")
    @classmethod
    def _fine_enough(cls, step: float) -> float:
        # An edge is believed where it goes on in neighbouring rows, and places of the absorber need several of them.
        if step > _LARGEST_STEP_MM:
            raise ValueError(f"{step:g} mm between nodes of the map is too coarse: at most {_LARGEST_STEP_MM:g} mm")
        return step


class RollingShutterSection(Section):
    """A camera that reads its rows one after the other while it flies; an empty table has the readout estimated.

    The camera is taken to fly straight on and to hold its direction while it reads a frame. Edges of panels do not tell
    their heights then.
    """

    readout_ms: Number | None = Field(
        None,
        description="Time from the first row to the last, negative where the last one is read first; default: "
        "estimated from the targets [ms].",
    )
    sigma_ms: Positive | None = Field(None, description="Its error, 1 sigma; default: 5 % [ms].")
    speed_m_s: Positive | None = Field(
        None, description="Speed over ground; default: by the times of photos or frames [m/s]."
    )

    @model_validator(mode="after")
    def _sigma_of_readout(self) -> Self:
        if self.readout_ms == 0:
            raise ValueError("readout_ms = 0 means that all rows are read at once; leave the table out then")
        if self.sigma_ms is not None and self.readout_ms is None:
            raise ValueError("sigma_ms is the error of readout_ms; give that, or leave both out")
        return self


class ObserverModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "observer"``."""

    kind: Literal["observer"] = Field(description="Photos of a trough that show the absorber's reflection.")
    collector: TroughSection = Field(description="The collector module: mirror, absorber, glass, panels, supports.")
    camera: CameraSections = Field(
        (NetworkCameraSection(),), description="The camera, or a table for each; default: self-calibration."
    )
    images: PassSection = Field(description="Photos or a video of the pass.")
    rolling_shutter: RollingShutterSection | None = Field(
        None, description="A rolling shutter, which reads row after row while the camera flies."
    )
    targets: KnownTargetsSection | None = Field(None, description="The targets on the collector.")
    corners: CornersSection | None = Field(
        None, description="Corners of the mirror panels as natural targets, instead of marked ones."
    )
    scale_bar: tuple[ScaleBarSection, ...] = Field((), description="Known distances of targets, as scale bars.")
    distance: tuple[DistanceSection, ...] = Field((), description="Known distances of targets, as measured by tape.")
    positions: PositionsSection | None = Field(
        None, description="The drone's own positions, which check the list of targets and the camera."
    )
    tilts: TiltsSection | None = Field(
        None, description="Readings of an inclinometer on a collector that turns before a fixed camera."
    )
    absorber: AbsorberSection = Field(AbsorberSection(), description="How the absorber's position is found.")
    sun: SunSection = Field(SunSection(), description="The sun for the intercept factor.")
    optics: OpticsSection = Field(OpticsSection(), description="What else spreads the beam.")
    evaluation: ObserverEvaluationSection = Field(ObserverEvaluationSection(), description="How the map is made.")
    module: tuple[ModuleSection, ...] = Field((), description="Several collectors in the same photos, a table each.")

    @property
    def targets_file(self) -> str | None:
        """The list of marked targets; None without."""
        return None if self.targets is None else self.targets.file

    @model_validator(mode="after")
    def _targets_or_corners(self) -> Self:
        if (self.targets is None) == (self.corners is None):
            raise ValueError("give [targets], or [corners] for photos without marked targets, one of both")
        if self.tilts is not None and (self.corners is None or self.positions is not None):
            raise ValueError("tilts: they belong to [corners] seen by one fixed camera, without [positions]")
        if self.corners is None:
            return self
        if self.rolling_shutter is not None and self.tilts is not None:
            raise ValueError("rolling_shutter: the camera of [tilts] stands still; leave the table out")
        if self.positions is None and self.tilts is None:
            raise ValueError(
                "corners: [positions] is needed: where the drone was, and how its camera was turned; or [tilts] of a "
                "collector that turned before a fixed camera"
            )
        if self.positions is not None and self.corners.azimuth_deg is None:
            raise ValueError("corners: azimuth_deg is needed with [positions]: the direction of +y, along the trough")
        if self.tilts is not None and self.images.video is not None:
            raise ValueError("tilts: give photos: readings belong to photos by their names or times")
        if self.module and (self.tilts is not None or any(one.targets_file for one in self.module)):
            raise ValueError("corners: several modules are found by the drone's positions, without lists of targets")
        if self.scale_bar or self.distance:
            raise ValueError("corners: scale_bar and distance are lengths between marked targets; leave them out")
        return self

    @property
    def is_coded(self) -> bool:
        """Whether each photo by itself says which targets it shows."""
        return self.targets is not None and self.targets.dictionary is not None and self.targets.tracked_from is None

    @model_validator(mode="after")
    def _rows_of_coded_targets(self) -> Self:
        if self.rolling_shutter is not None and self.targets is not None and not self.is_coded:
            raise ValueError(
                "rolling_shutter: targets with codes are needed, which each photo names by itself: give [targets] a "
                "dictionary and no tracked_from; or hover for each photo and leave the table out"
            )
        return self

    @model_validator(mode="after")
    def _several_modules(self) -> Self:
        if (twice := repeated(one.name.lower() for one in self.module)) is not None:
            raise ValueError(f"module: the name {twice} occurs twice; each module gets a folder of its name")
        if self.module and self.targets and not self.is_coded:
            raise ValueError("module: several modules are distinguished by coded targets; give targets a dictionary")
        if self.module and (self.absorber.file is not None or self.absorber.photos is not None):
            raise ValueError("module: the absorbers of several modules are found in the common photos, or as designed")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class ObserverMeasurement:
    """Checked photos of a trough: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
    photo_files: The photos of the pass, or the frames of its video (`heliogauge.images.video`).
    absorber_files: Photos that are taken for the absorber's position alone.
    doubts: What is wrong with a video and was got round.
    """

    folder: Path
    model: ObserverModel
    photo_files: tuple[Path, ...]
    absorber_files: tuple[Path, ...]
    doubts: tuple[Doubt, ...] = ()

    @property
    def all_photos(self) -> tuple[Path, ...]:
        """Photos of the pass, then those of the absorber alone that are not among them."""
        return tuple(dict.fromkeys((*self.photo_files, *self.absorber_files)))

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        model = self.model
        named = [*(one.file for one in model.camera), model.targets_file, model.absorber.file, model.sun.file]
        named += [one.targets_file for one in model.module]
        named += [] if model.positions is None else [model.positions.file]
        named += [] if model.tilts is None else [model.tilts.file]
        if model.module and all(one.targets_file for one in model.module):
            named.remove(model.targets_file)
        own = (self.folder / MEASUREMENT_FILE, *(self.folder / name for name in named if name))
        return (*own, *dict.fromkeys(video_of(file) for file in self.all_photos))


def load_observer(folder: Path) -> ObserverMeasurement:
    """Read and check a folder with photos of a trough.

    Parameters
    ----------
    folder : Path
        Folder with measurement.toml; the files it names are relative to it.

    Returns
    -------
    ObserverMeasurement
        The measurement; every file it names exists.

    Raises
    ------
    InputError
        As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, ObserverModel)
    images = model.images
    doubts: tuple[Doubt, ...] = ()
    if images.video is not None:
        # OpenCV costs 0.1 s, which only a video is worth.
        from heliogauge.images.video import list_frames

        frames = list_frames(folder / images.video, every_nth=images.every_nth)
        photos, doubts = frames.files, frames.doubts
    else:
        photos = image_files(folder, "images.photos", images.photos or ())
    own = model.absorber.photos
    absorber = () if own is None else image_files(folder, "absorber.photos", own)
    found = ObserverMeasurement(folder, model, photos, absorber, doubts)
    refuse_missing(file, found.input_files)
    return found
