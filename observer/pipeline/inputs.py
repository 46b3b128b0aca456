"""From what measurement.toml says to a collector, a list of targets and a start for the absorber."""

from pathlib import Path
from typing import Literal

import numpy as np

from heliogauge.errors import InputError
from heliogauge.measurement.models import PhotosSection
from heliogauge.results.tables import read_table_csv
from observer.files import number_in_cell
from observer.keys import ObserverMeasurement, TroughSection
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, GlassTube
from photogrammetry.keys import (
    CoordinateSection,
    DatumSection,
    PhotogrammetryMeasurement,
    PhotogrammetryModel,
    TargetsSection,
)

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


def as_photogrammetry(measurement: ObserverMeasurement) -> PhotogrammetryMeasurement:
    """Return the photo network that tells where the cameras stood in the trough's frame.

    Returns: The same photos, with the listed coordinates as weighted observations.
    InputError: A list of targets that cannot be used, or several modules.
    """
    model = measurement.model
    if model.module:
        raise InputError(
            f"module: a flight over {len(model.module)} collectors; `heliogauge observer FOLDER -o OUT`, or "
            "observer.pipeline.modules, evaluates it"
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


def absorber_start(collector: Collector) -> AbsorberPath:
    """Return the absorber where the design has it.

    Returns: In the focal line, as long as the collector.
    """
    return AbsorberPath.straight(0.0, collector.focal_length_m, collector.length_m / 2)
