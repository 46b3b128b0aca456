"""From what measurement.toml says to a collector, a list of targets and a start for the absorber."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from heliogauge.errors import InputError
from heliogauge.measurement.load import PhotogrammetryMeasurement
from heliogauge.measurement.models import PhotosSection
from heliogauge.results.tables import read_table_csv
from heliogauge.validate import FloatArray
from observer.keys import ObserverMeasurement, TroughSection
from observer.photo_edges.module_targets import spans_an_area
from observer.pipeline.photos import FirstLook
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, GlassTube
from photogrammetry.keys.measurement import (
    CoordinateSection,
    DatumSection,
    PhotogrammetryModel,
)
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.matching.target_following import KnownTargets
from photogrammetry.start_values.resection import LEAST_TARGETS

#: A coordinate known to worse than this is no help to find a photo's pose [m].
_LARGEST_SIGMA_M = 0.1
AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")


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
        section.aperture_width_m, section.length_m, section.focal_length_m, 1e-3 * section.absorber_diameter_mm, glass,
        np.array(section.panel_edges_x_m), np.array(section.panel_edges_y_m), 1e-3 * section.panel_gap_mm,
        np.array(section.support_y_m), section.support_width_m, 1e-3 * section.panel_height_sigma_mm,
    )  # fmt: skip


def target_constraints(path: Path) -> tuple[CoordinateSection, ...]:
    """Read the list of targets.

    path: Table with the columns target, x_m, y_m, z_m and sigma_x_mm, sigma_y_mm, sigma_z_mm (or sigma_mm for all
        three); an empty cell stands for a coordinate that is not known.
    InputError: A missing column, a cell that is not a number, a target that is listed twice, or no known
        coordinate.
    """
    table = read_table_csv(path, ("target", "x_m", "y_m", "z_m"))
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
            value = _number(path, line, f"{axis}_m", table[f"{axis}_m"][line - 2])
            name = "sigma_mm" if one_for_all else f"sigma_{axis}_mm"
            sigma = _number(path, line, name, table[name][line - 2])
            if value is None or sigma is None:
                continue
            if sigma <= 0:
                raise InputError(f"{path}, line {line}: {name} = {sigma:g}: a value above 0 is needed, in millimetres")
            found.append(CoordinateSection(kind="coordinate", target=target, axis=axis, value_m=value, sigma_mm=sigma))
    if not found:
        raise InputError(f"{path}: no target has a coordinate with its sigma; at least seven coordinates are needed")
    return tuple(found)


def _number(path: Path, line: int, name: str, cell: str) -> float | None:
    if cell == "":
        return None
    try:
        value = float(cell)
    except ValueError:
        raise InputError(
            f"{path}, line {line}: {name} = {cell!r} is not a number; is the decimal sign a point?"
        ) from None
    return value if np.isfinite(value) else None


def as_photogrammetry(measurement: ObserverMeasurement) -> PhotogrammetryMeasurement:
    """Return the photo network that tells where the cameras stood in the trough's frame.

    Returns: The same photos, with the listed coordinates as weighted observations.
    InputError: A list of targets that cannot be used, or several modules.
    """
    model = measurement.model
    if model.module:
        raise InputError(
            f"module: a flight over {len(model.module)} collectors; `heliogauge observer FOLDER -o OUT`, or "
            "observer.commands.modules, evaluates it"
        )
    files = (*measurement.photo_files, *(file for file in measurement.absorber_files
                                         if file not in measurement.photo_files))  # fmt: skip
    targets = TargetsSection.model_validate(model.targets.model_dump(exclude={"file"}, exclude_unset=True))
    if targets.dictionary is not None and not targets.is_listed and targets.find_uncoded is None:
        # Dots that nobody lists add nothing to poses that a dozen known targets tell, and cost time in every photo.
        targets = targets.model_copy(update={"find_uncoded": False})
    known = measurement.coordinates
    if known is None:
        known = target_constraints(measurement.folder / model.targets.file)
    network = PhotogrammetryModel(
        kind="photogrammetry",
        name=model.name,
        camera=model.camera,
        images=PhotosSection(photos=tuple(str(file.relative_to(measurement.folder)) for file in files)),
        targets=targets,
        scale_bar=model.scale_bar,
        constraint=(*known, *model.distance),
        datum=DatumSection(kind="inner"),
    )
    return PhotogrammetryMeasurement(measurement.folder, network, files)


def known_targets(network: PhotogrammetryMeasurement) -> KnownTargets:
    """Collect the targets whose three coordinates are listed.

    Returns: Targets to start from; those known to worse than 0.1 m are not among them.
    """
    values: dict[str, dict[str, tuple[float, float]]] = {}
    for one in network.model.constraint:
        if isinstance(one, CoordinateSection) and 1e-3 * one.sigma_mm <= _LARGEST_SIGMA_M:
            values.setdefault(one.target, {})[one.axis] = (one.value_m, 1e-3 * one.sigma_mm)
    whole = {name: [axes[axis] for axis in AXES] for name, axes in values.items() if len(axes) == len(AXES)}
    table = np.array(list(whole.values()), dtype=np.float64).reshape(-1, len(AXES), 2)
    return KnownTargets(tuple(whole), np.ascontiguousarray(table[..., 0]), table[..., 1].max(axis=1, initial=0.0))


def absorber_start(collector: Collector) -> AbsorberPath:
    """Return the absorber where the design has it.

    Returns: In the focal line, as long as the collector.
    """
    return AbsorberPath.straight(0.0, collector.focal_length_m, collector.length_m / 2)


def read_absorber(path: Path) -> AbsorberPath:
    """Read where the absorber is.

    path: Table with the columns y_m, x_a_m, z_a_m, sigma_x_a_m, sigma_z_a_m, such as the ``absorber.csv`` of a
        result.
    Returns: The axis; its stations are taken as independent of each other.
    InputError: Missing columns or cells that are not numbers.
    """
    names = ("y_m", "x_a_m", "z_a_m", "sigma_x_a_m", "sigma_z_a_m")
    table = read_table_csv(path, names)
    rows: list[list[float]] = []
    for line in range(2, len(table["y_m"]) + 2):
        values = [_number(path, line, name, table[name][line - 2]) for name in names]
        # A station that was not measured has empty cells.
        if None not in values:
            rows.append([float(value) for value in values if value is not None])
    if not rows:
        raise InputError(f"{path}: no row is complete; the columns {', '.join(names)} are needed")
    columns: FloatArray = np.array(rows).T
    return AbsorberPath(
        columns[0], columns[1], columns[2], np.diag(np.square(np.concatenate([columns[3], columns[4]])))
    )


def photos_with_poses(
    survey: PhotogrammetryMeasurement, first: FirstLook, known: KnownTargets
) -> tuple[PhotogrammetryMeasurement, FirstLook, str | None]:
    """Leave out photos whose targets are all on one line, as those of one rim: the camera may be anywhere around it.

    first: What was found in the photos.
    known: Those whose coordinates are listed.
    survey: Without those photos. A photo with targets that are not listed is kept, since others may tell them.
    """
    place = dict(zip(known.names, known.points_m, strict=True))
    on_line = set()
    for one in first.targets:
        names = one.detections.names
        listed = np.array([place[name] for name in names if name in place]).reshape(-1, 3)
        if len(listed) == len(names) >= LEAST_TARGETS and not spans_an_area(listed):
            on_line.add(one.detections.photo)
    if not on_line:
        return survey, first, None
    targets = tuple(one for one in first.targets if one.detections.photo not in on_line)
    poses = {name: pose for name, pose in first.poses.items() if name not in on_line}
    files = tuple(file for file in survey.photo_files if file.name not in on_line)
    doubt = (
        f"{len(on_line)} photos show targets along one line only, as those of one rim, which tell no pose, and were "
        f"left out: {', '.join(sorted(on_line)[:5])}{' ...' if len(on_line) > 5 else ''}"
    )
    return replace(survey, photo_files=files), replace(first, targets=targets, poses=poses), doubt
