"""A measurement as values: what measurement.toml and its tables say, read once; no later stage looks there again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.models import PhotosSection
from heliogauge.results.folder import hash_files, refuse_copies
from heliogauge.results.sun_tables import read_sun
from heliogauge.results.tables import read_table_csv
from heliogauge.running.progress import Progress
from heliogauge.sunlight.sun_shapes import BuieSun, GaussianSun, PillboxSun, SunShape
from heliogauge.validate import FloatArray
from observer.corners.lattice import PanelLattice
from observer.corners.tie import SearchedCollector
from observer.doubts.stated_collector import panels_doubts, supports_doubt
from observer.files import ABSORBER_COLUMNS, absorber_of_table, is_number, number_in_cell
from observer.keys import ObserverMeasurement, SunSection, TroughSection
from observer.light.trace import Sunlight
from observer.photo_edges.tone import Tone
from observer.pipeline.corners import CornerSearch
from observer.pipeline.reading.photos import Finder, build_finder
from observer.pipeline.reading.target_kinds import TargetKinds, target_kinds
from observer.pipeline.reading.tone import Encoding, Encodings
from observer.pipeline.rolling_shutter import Shutter, frame_motion_m, read_shutter
from observer.pipeline.tilts import Tilts, read_tilts
from observer.slopes.row_spline import Roughness
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, GlassTube
from observer.trough.expectation import Expectation
from photogrammetry.bundle import constraints
from photogrammetry.keys import (
    CoordinateSection,
    DatumSection,
    NaturalSection,
    PhotogrammetryMeasurement,
    PhotogrammetryModel,
    TargetsSection,
)
from photogrammetry.matching import KnownTargets
from photogrammetry.pipeline import read_drone_positions

#: Columns of a table as text, by their names.
Table = Mapping[str, Sequence[str]]

#: A coordinate known to worse than this is no help to find a photo's pose [m].
_LARGEST_SIGMA_M = 0.1
#: What the roughness across the trough is searched from [rad^2 / m^3].
_FIRST_ROUGHNESS = 1e-3
AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
#: Columns of the list of targets beside those of the sigmas.
TARGET_COLUMNS = ("target", "x_m", "y_m", "z_m")


class Tables(NamedTuple):
    """Tables that measurement.toml names, as text but for the sun; None where it names none."""

    targets: Table | None
    absorber: Table | None
    sun: SunShape | None


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What is known of a collector and its photos before these are read.

    name: Name of what is measured.
    collector: The design.
    orientation_rad: Turn of the collector from zenith, by the right hand about +y [rad].
    light: What shines, and what spreads it.
    survey: The photo network.
    finder: What is looked for in each photo.
    targets_file: Name of the list of targets, for messages.
    corners: What predicts the corners of panels, where these take the place of marked targets.
    tilts: Readings of a collector that turns before a fixed camera.
    shutter: What is stated of a rolling shutter; None: all rows are read at once.
    absorber: The tube's axis: of the table, or of the design where it is measured or assumed.
    absorber_source: Whether it is measured in the photos, from a table, or as designed.
    stations_m (n,): Places along the trough at which it is measured [m].
    column_step_m: Wanted distance of the nodes of the map across the trough [m].
    prior: How slopes may vary.
    shape_from_slopes: Whether the mirror's surface follows its slopes; None: as the reflection shows.
    doubts: What is wrong with the photos' files and was worked around, and what is assumed of the tube.
    panels_doubts: What measurement.toml lacks of the mirror's panels.
    input_sha256: Hash of each file.
    n_modules: Modules of the flight, this one among them.
    """

    name: str
    collector: Collector
    orientation_rad: float
    light: Sunlight
    survey: PhotogrammetryMeasurement
    finder: Finder
    targets_file: str
    absorber: AbsorberPath
    absorber_source: Literal["photos", "file", "design"]
    stations_m: FloatArray
    column_step_m: float
    prior: Roughness
    shape_from_slopes: bool | None
    doubts: tuple[Doubt, ...]
    panels_doubts: tuple[Doubt, ...] = ()
    corners: CornerSearch | None = None
    tilts: Tilts | None = None
    shutter: Shutter | None = None
    input_sha256: Mapping[str, str] = field(default_factory=dict)
    n_modules: int = 1


def read_inputs(measurement: ObserverMeasurement, progress: Progress) -> Inputs:
    """Read everything but the photos.

    measurement: Of a single collector.
    InputError: Targets, camera, tables or dimensions that cannot be used, copies among the photos, or several modules.
    """
    refuse_modules(measurement)
    tables = read_tables(measurement, measurement.model.targets_file)
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    refuse_copies(measurement.all_photos, hashes, measurement.folder)
    return replace(build_inputs(measurement, tables, coordinates_of(measurement, tables)), input_sha256=hashes)


def coordinates_of(measurement: ObserverMeasurement, tables: Tables) -> tuple[CoordinateSection, ...]:
    """Return the coordinates of the list of targets; none without marked targets.

    InputError: As from `listed_coordinates`.
    """
    file = measurement.model.targets_file
    if file is None or tables.targets is None:
        return ()
    return listed_coordinates(tables.targets, measurement.folder / file)


def read_tables(measurement: ObserverMeasurement, targets_file: str | None) -> Tables:
    """Read the tables that measurement.toml names.

    targets_file: The list of targets; None without marked ones.
    InputError: A table that cannot be read, or lacks a column.
    """
    folder, absorber, sun = measurement.folder, measurement.model.absorber.file, measurement.model.sun.file
    return Tables(
        None if targets_file is None else read_table_csv(folder / targets_file, TARGET_COLUMNS),
        None if absorber is None else read_table_csv(folder / absorber, ABSORBER_COLUMNS),
        None if sun is None else read_sun(folder / sun),
    )


def left_out_doubts(tables: Tables) -> list[Doubt]:
    """Say which rows of the tables have no part in the measurement because cells are empty or not finite."""
    doubts = []
    absorber = tables.absorber
    if absorber is not None:
        count = len(absorber["y_m"])
        rows = zip(*(absorber[name] for name in ABSORBER_COLUMNS), strict=True)
        gaps = sum(not all(map(is_number, cells)) for cells in rows)
        if gaps:
            text = (
                f"absorber.file: {gaps} of {count} stations have empty cells and were left out; fill them in, or take "
                "the rows out"
            )
            doubts.append(Doubt("absorber_stations_left_out", text, {"left_out_count": gaps, "stations_count": count}))
    targets = tables.targets
    if targets is None:
        return doubts
    names = ["sigma_mm"] * 3 if "sigma_mm" in targets else [f"sigma_{axis}_mm" for axis in AXES]
    pairs = [
        pair
        for axis, name in zip(AXES, names, strict=True)
        if name in targets
        for pair in zip(targets[f"{axis}_m"], targets[name], strict=True)
    ]
    alone = sum(is_number(value) and not is_number(sigma) for value, sigma in pairs)
    if alone:
        text = (
            f"targets.file: {alone} of {len(pairs)} coordinates have no sigma and were left out; say how well they are "
            "known, or leave their cells empty"
        )
        doubts.append(Doubt("coordinates_left_out", text, {"left_out_count": alone, "coordinates_count": len(pairs)}))
    return doubts


def refuse_modules(measurement: ObserverMeasurement) -> None:
    """Refuse a flight over several modules where one collector is measured.

    InputError: The measurement names modules.
    """
    if measurement.model.module:
        raise InputError(
            f"module: a flight over {len(measurement.model.module)} collectors; "
            "`heliogauge observer measure FOLDER -o OUT` evaluates it"
        )


def build_inputs(
    measurement: ObserverMeasurement,
    tables: Tables,
    coordinates: Sequence[CoordinateSection],
    place_m: Sequence[float] = (0.0, 0.0, 0.0),
) -> Inputs:
    """Return a measurement as values.

    coordinates: Known coordinates of targets in the trough's frame.
    place_m: Without marked targets: the collector's origin from that which several have in common [m].
    Returns: Without the hashes of files.
    InputError: Targets, camera, tables or dimensions that cannot be used.
    """
    model, folder = measurement.model, measurement.folder
    collector = build_collector(model.collector)
    light = Sunlight(
        build_sun(model.sun, tables.sun),
        1e-3 * model.optics.specularity_mrad,
        1e-3 * model.optics.tracking_error_mrad,
    )
    design = absorber = AbsorberPath.designed(collector)
    if tables.absorber is not None:
        absorber = absorber_of_table(tables.absorber, folder / str(model.absorber.file))
    rows = collector.rows_m(1e-3 * model.evaluation.row_step_mm)
    expected = Expectation(collector, design, rows, 1e-3 * model.evaluation.largest_slope_error_mrad)
    tilts = read_tilts(measurement)
    corners, kinds = build_corners(measurement, collector, tilts, place_m), None
    if corners is not None:
        lattice = corners.lattice
        survey = build_corner_survey(measurement, lattice)
        sigma_m = np.sqrt(np.diag(lattice.covariance_m2).reshape(-1, 3).max(axis=1))
        known = KnownTargets(lattice.names, lattice.points_m, sigma_m)
    else:
        if tables.targets is not None and model.targets is not None:
            kinds = target_kinds(tables.targets, folder / model.targets.file)
        survey, known = build_survey(measurement, coordinates, kinds), known_targets(coordinates)
    encodings = None
    if model.images.encoding != "auto":
        encodings = Encodings((Encoding("", Tone(model.images.encoding)),))
    return Inputs(
        model.name,
        collector,
        float(np.radians(model.collector.orientation_deg)),
        light,
        survey,
        build_finder(survey, known, expected, encodings, kinds),
        model.targets_file or MEASUREMENT_FILE,
        absorber,
        model.absorber.source,
        collector.stations_m(model.absorber.station_step_m),
        1e-3 * model.evaluation.column_step_mm,
        Roughness(_FIRST_ROUGHNESS, 1e-3 * model.evaluation.longitudinal_slope_mrad),
        model.evaluation.shape_from_slopes,
        gather_doubts(measurement.doubts, left_out_doubts(tables), supports_doubt(model.collector)),
        tuple(panels_doubts(model.collector)),
        corners,
        tilts,
        read_shutter(model.rolling_shutter, measurement.photo_files),
    )


def build_collector(section: TroughSection) -> Collector:
    """Return the collector that measurement.toml describes.

    InputError: Dimensions that cannot be.
    """
    glass = None
    if section.glass_outer_diameter_mm is not None and section.glass_inner_diameter_mm is not None:
        glass = GlassTube(
            1e-3 * section.glass_outer_diameter_mm, 1e-3 * section.glass_inner_diameter_mm, section.glass_index
        )
    return Collector(
        section.aperture_width_m,
        section.length_m,
        section.focal_length_m,
        1e-3 * section.absorber_diameter_mm,
        glass,
        np.array(section.panel_edges_x_m),
        np.array(section.panel_edges_y_m),
        1e-3 * section.panel_gap_mm,
        np.array(section.support_y_m),
        section.support_width_m,
        1e-3 * section.panel_height_sigma_mm,
    )


def read_targets(path: Path) -> tuple[CoordinateSection, ...]:
    """Read the list of targets.

    path: Table with the columns target, x_m, y_m, z_m and sigma_x_mm, sigma_y_mm, sigma_z_mm (or sigma_mm for all
        three); an empty cell stands for a coordinate that is not known.
    InputError: As from `listed_coordinates`.
    """
    return listed_coordinates(read_table_csv(path, TARGET_COLUMNS), path)


def listed_coordinates(table: Table, path: Path) -> tuple[CoordinateSection, ...]:
    """Return the coordinates of a list of targets.

    path: Where the list was read, for messages.
    InputError: A missing column, a cell that is not a number, a target that is listed twice, or no known
        coordinate.
    """
    one_for_all = "sigma_mm" in table
    wanted = ["sigma_mm"] if one_for_all else [f"sigma_{axis}_mm" for axis in AXES]
    missing = [name for name in wanted if name not in table]
    if missing:
        raise InputError(f"{path}: there is no column {', '.join(missing)}; say how well the coordinates are known")
    seen: dict[str, int] = {}
    found = []
    for line, target in enumerate(table["target"], start=2):
        if target in seen:
            raise InputError(f"{path}, line {line}: target {target} stands in line {seen[target]} already")
        seen[target] = line
        for axis in AXES:
            value = number_in_cell(path, line, f"{axis}_m", table[f"{axis}_m"][line - 2])
            name = "sigma_mm" if one_for_all else f"sigma_{axis}_mm"
            sigma = number_in_cell(path, line, name, table[name][line - 2])
            if value is None or sigma is None:
                continue
            if sigma <= 0:
                raise InputError(f"{path}, line {line}: {name} = {sigma:g}: a value above 0 is needed, in millimetres")
            found.append(CoordinateSection(kind="coordinate", target=target, axis=axis, value_m=value, sigma_mm=sigma))
    if not found:
        raise InputError(f"{path}: no target has a coordinate with its sigma; at least seven coordinates are needed")
    return tuple(found)


def build_survey(
    measurement: ObserverMeasurement, coordinates: Sequence[CoordinateSection], kinds: TargetKinds | None = None
) -> PhotogrammetryMeasurement:
    """Return the photo network from which it is estimated where the cameras stood in the trough's frame.

    kinds: What the listed targets look like.
    Returns: The same photos, with the listed coordinates as weighted observations.
    """
    model, files = measurement.model, measurement.all_photos
    if model.targets is None:
        raise InputError("targets: the table [targets] is needed; it says what targets the photos show")
    said = model.targets.model_dump(exclude={"file"}, exclude_unset=True)
    plain = () if kinds is None else _plain_targets(coordinates, kinds)
    if (
        plain
        and not model.targets.is_listed
        and not (model.targets.dictionary and all(c.is_known for c in model.camera))
    ):
        # Dots that no photo can name by itself: by the list alone, or through the poses that codes give.
        said["uncoded"] = plain
    if kinds is not None and kinds.common_diameter_m is not None and model.targets.diameter_mm is None:
        said["diameter_mm"] = 1e3 * kinds.common_diameter_m
    targets = TargetsSection.model_validate(said)
    if targets.dictionary is not None and not targets.is_listed and targets.find_uncoded is None:
        # Dots that nobody lists add nothing to poses that a dozen known targets determine, and cost time.
        targets = targets.model_copy(update={"find_uncoded": False})
    network = PhotogrammetryModel(
        kind="photogrammetry",
        name=model.name,
        camera=model.camera,
        images=PhotosSection(photos=tuple(str(file.relative_to(measurement.folder)) for file in files)),
        targets=targets,
        scale_bar=model.scale_bar,
        constraint=(*coordinates, *model.distance),
        datum=DatumSection(kind="inner"),
        positions=model.positions,
    )
    return PhotogrammetryMeasurement(measurement.folder, network, files)


def build_corners(
    measurement: ObserverMeasurement,
    collector: Collector,
    tilts: Tilts | None = None,
    place_m: Sequence[float] = (0.0, 0.0, 0.0),
) -> CornerSearch | None:
    """Return what predicts the corners of panels; None where targets are marked.

    tilts: Readings of a collector that turns before a fixed camera.
    place_m: Its origin, level: across, along and up from that which several collectors have in common [m].
    InputError: Positions that cannot be read, or a drawing without corners that can be seen.
    """
    section, positions = measurement.model.corners, measurement.model.positions
    if section is None:
        return None
    alike_mm = section.corner_sigma_mm if section.alike_sigma_mm is None else section.alike_sigma_mm
    sigmas_mm = section.mounting_sigma_mm, section.corner_sigma_mm, alike_mm
    lattice = PanelLattice(collector, *(1e-3 * sigma for sigma in sigmas_mm))
    turn_sigma = float(np.radians(section.turn_sigma_deg))
    if tilts is not None:
        own = SearchedCollector(lattice, np.eye(3), np.zeros(3), np.zeros(3), turn_sigma)
        return CornerSearch(own, tilts.places(), is_tied=True)
    if positions is None or section.azimuth_deg is None:
        return None
    turn = np.radians(section.azimuth_deg)
    along = np.array([np.sin(turn), np.cos(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    tilted = rotation_from_vector(np.radians(measurement.model.collector.orientation_deg) * np.array([0.0, 1.0, 0.0]))
    found = read_drone_positions(build_corner_survey(measurement, lattice))
    if found is None:
        return None
    enu_from_level = np.stack([np.cross(along, up), along, up], axis=1)
    lever = 1e-3 * np.array(positions.lever_arm_mm)
    own = SearchedCollector(lattice, enu_from_level @ tilted, enu_from_level @ np.array(place_m), lever, turn_sigma)
    rolling = measurement.model.rolling_shutter
    places = dict(zip(found.photos, found.enu_m, strict=True))
    motion_m = 0.0 if rolling is None else frame_motion_m(rolling, measurement.photo_files, places)
    return CornerSearch(own, found, motion_sigma_m=motion_m)


def build_corner_survey(measurement: ObserverMeasurement, lattice: PanelLattice) -> PhotogrammetryMeasurement:
    """Return the photo network of the panels' corners, their places by the drawing as weighted observations."""
    model, files = measurement.model, measurement.all_photos
    network = PhotogrammetryModel(
        kind="photogrammetry",
        name=model.name,
        camera=model.camera,
        images=PhotosSection(photos=tuple(str(file.relative_to(measurement.folder)) for file in files)),
        natural=NaturalSection(),
        datum=DatumSection(kind="inner"),
        positions=model.positions,
    )
    known = constraints.KnownPlaces(lattice.names, lattice.points_m, lattice.covariance_m2)
    return PhotogrammetryMeasurement(measurement.folder, network, files, (known,))


def _plain_targets(coordinates: Sequence[CoordinateSection], kinds: TargetKinds) -> tuple[dict[str, object], ...]:
    """Return the dots without a code of the list whose three coordinates it has, as keys of measurement.toml."""
    known = known_targets(coordinates)
    return tuple(
        {"target": name, "xyz_m": tuple(place), "sigma_mm": 1e3 * sigma}
        for name, place, sigma in zip(known.names, known.points_m.tolist(), known.sigma_m.tolist(), strict=True)
        if name in kinds.plain
    )


def known_targets(coordinates: Sequence[CoordinateSection]) -> KnownTargets:
    """Collect the targets whose three coordinates are listed.

    Returns: Targets to start from; those known to worse than 0.1 m are not among them.
    """
    values: dict[str, dict[str, tuple[float, float]]] = {}
    for one in coordinates:
        if 1e-3 * one.sigma_mm <= _LARGEST_SIGMA_M:
            values.setdefault(one.target, {})[one.axis] = (one.value_m, 1e-3 * one.sigma_mm)
    whole = {name: [axes[axis] for axis in AXES] for name, axes in values.items() if len(axes) == len(AXES)}
    table = np.array(list(whole.values()), dtype=np.float64).reshape(-1, len(AXES), 2)
    return KnownTargets(tuple(whole), np.ascontiguousarray(table[..., 0]), table[..., 1].max(axis=1, initial=0.0))


def build_sun(section: SunSection, table: SunShape | None) -> SunShape:
    """Return the sun shape that measurement.toml describes.

    table: That of ``shape = "table"``.
    """
    if table is not None:
        return table
    if section.shape == "pillbox":
        return PillboxSun(1e-3 * section.half_angle_mrad)
    if section.shape == "buie":
        return BuieSun.of_share(section.circumsolar_ratio)
    return GaussianSun(1e-3 * section.sigma_mrad)
