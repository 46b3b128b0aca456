"""Photos and results against what measurement.toml says of the collector: every contradiction becomes a sentence."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliogauge.images.photos import read_luma
from heliogauge.measurement.load import PhotogrammetryMeasurement
from heliogauge.results.tables import PointTable
from heliogauge.slopes.map import SlopeMap
from observer.doubts.design_checks import (
    diameter_doubt,
    diameter_of_absorber,
    focal_length_doubt,
    focal_length_of_mirror,
    outline_doubts,
    overexposure_doubt,
)
from observer.photo_edges.outline import clipped_share, photos_from_above, plates_of, rims_in_photo, spans_of
from observer.photo_edges.reprojection import View
from observer.photo_edges.target_list_checks import (
    refuse_loose_frame,
    refuse_strange_targets,
    refuse_upside_down,
    stray_targets,
)
from observer.pipeline.inputs import AXES
from observer.pipeline.photos import Finder, FirstLook
from observer.selection.select_and_solve import Reflector
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from photogrammetry.keys.measurement import CoordinateSection
from photogrammetry.pipeline import measure as photogrammetry_pipeline

#: Where a target is in a photo before all are adjusted: pose and centre together [px].
_POINT_PX = 0.3


def design_doubts(
    photos: tuple[Sequence[Path], Sequence[View], PointTable],
    reflector: Reflector,
    slope_map: SlopeMap,
    absorber: AbsorberPath,
    collector: Collector,
    *,
    with_sizes: bool = True,
) -> tuple[str, ...]:
    """Compare width, length, focal length and tube diameter as stated with what the photos show.

    photos: Files and views of the network's photos, of which seven are read; its targets.
    slope_map: The mirror in the common form.
    absorber: The tube's axis.
    with_sizes: Whether focal length and tube are judged; not by a wrong camera or by a few photos, which contradict
        right ones.
    Returns: What does not fit; and whether the mirror is overexposed.
    InputError: A photo cannot be read.
    """
    files, views, targets = photos
    plates = plates_of(targets.ids, targets.xyz_m)
    eyes = np.array([pose.inverse().translation_m for _, pose in views])
    rims, clipped = [], []
    for number in photos_from_above(eyes):
        image = read_luma(files[number])
        rims.append(rims_in_photo(image, views[number], collector, plates))
        clipped.append(clipped_share(image, views[number], collector))
    said = [overexposure_doubt(float(np.median(clipped)))]
    if with_sizes:
        said += [
            focal_length_doubt(focal_length_of_mirror(slope_map, collector), absorber, collector),
            diameter_doubt(diameter_of_absorber(reflector, collector), collector),
        ]
    said += outline_doubts(*spans_of(np.array(rims)), collector)
    return tuple(text for text in said if text is not None)


def refuse_strange_list(survey: PhotogrammetryMeasurement, first: FirstLook, file: str) -> None:
    """Refuse a list whose targets are not those in the photos, before they are adjusted.

    first: What was found in the photos.
    InputError: Fewer than three listed targets are seen.
    """
    listed = dict.fromkeys(one.target for one in survey.model.constraint if isinstance(one, CoordinateSection))
    seen = [name for one in first.targets for name in one.detections.names]
    refuse_strange_targets(tuple(listed), seen, file)


def refuse_loose_list(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement, collector: Collector
) -> None:
    """Refuse a list of targets that does not tell where the trough's frame lies, or turns it upside down.

    InputError: z has the wrong sign.
    EstimationError: The frame is free to turn.
    """
    table = network.points
    row = {name: number for number, name in enumerate(table.ids)}
    sigma = np.full((len(row), 3), np.nan)
    for one in survey.model.constraint:
        if isinstance(one, CoordinateSection) and one.target in row:
            sigma[row[one.target], AXES.index(one.axis)] = 1e-3 * one.sigma_mm
    used = np.isfinite(sigma).any(axis=1) & np.isfinite(table.xyz_m).all(axis=1)
    refuse_loose_frame(table.xyz_m[used], sigma[used])
    refuse_upside_down(table.xyz_m[used], collector)


def without_strays(
    survey: PhotogrammetryMeasurement, first: FirstLook, finder: Finder
) -> tuple[PhotogrammetryMeasurement, str | None]:
    """Leave out the coordinates of targets that the photos show elsewhere, as where two were exchanged in the list.

    first: What was found in the photos.
    survey: Without those coordinates; the targets are measured like others that are not listed.
    """
    known = finder.known
    place = {name: number for number, name in enumerate(known.names)}
    off: list[list[float]] = [[] for _ in known.names]
    pixel_m = []
    for one in first.targets:
        table = one.detections
        pose, camera = first.poses.get(table.photo), finder.camera_of.get(table.photo)
        rows = [k for k, name in enumerate(table.names) if name in place and table.usable[k]]
        if pose is None or camera is None or not rows:
            continue
        own = [place[table.names[k]] for k in rows]
        seen = pose.apply(known.points_m[own])
        for number, miss in zip(own, np.linalg.norm(camera.project(seen) - table.pixels_px[rows], axis=1), strict=True):
            off[number].append(float(miss))
        pixel_m.append(float(np.median(seen[:, 2])) / camera.focal_x_px)
    shown = [number for number, values in enumerate(off) if values]
    if not shown:
        return survey, None
    usual = np.array([float(np.median(off[number])) for number in shown])
    step = float(np.median(pixel_m))
    which = stray_targets(usual, np.hypot(_POINT_PX, known.sigma_m[shown] / step))
    if not which.any():
        return survey, None
    names = [known.names[number] for number, stray in zip(shown, which, strict=True) if stray]
    kept = tuple(
        one for one in survey.model.constraint if not (isinstance(one, CoordinateSection) and one.target in names)
    )
    listed = ", ".join(f"{name} ({1e3 * step * far:.0f} mm)" for name, far in zip(names, usual[which], strict=True))
    return replace(survey, model=survey.model.model_copy(update={"constraint": kept})), (
        f"targets: not where the list has them: {listed}; their coordinates were not used. Were two exchanged, one "
        "moved, or a number mistyped?"
    )
