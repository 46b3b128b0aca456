"""The list of targets beside what the photos show: known places, photos and entries left out, lists refused."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.doubts import Doubt
from observer.pipeline.inputs import AXES, Inputs
from observer.pipeline.photos import Finder, FirstLook
from observer.targets.list_checks import refuse_loose_frame, refuse_strange_targets, refuse_upside_down, stray_targets
from observer.targets.module_targets import spans_an_area
from observer.trough.collector import Collector
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.keys import CoordinateSection, PhotogrammetryMeasurement
from photogrammetry.matching import KnownTargets
from photogrammetry.start_values import LEAST_TARGETS

#: Where a target is in a photo before all are adjusted: pose and centre together [px].
_POINT_PX = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class CheckedList:
    """The photo network and what was found in its photos, without what contradicts the list of targets.

    doubts: What was left out.
    """

    survey: PhotogrammetryMeasurement
    first: FirstLook
    doubts: tuple[Doubt, ...] = ()


def check_list(inputs: Inputs, first: FirstLook) -> CheckedList:
    """Leave out photos that determine no pose and coordinates that the photos contradict.

    first: What was found in the photos.
    InputError: The list is not that of the targets in the photos.
    """
    found = leave_out_lines(inputs.survey, first, inputs.finder.known)
    refuse_strange_list(found.survey, found.first, inputs.targets_file)
    return leave_out_strays(found, inputs.finder)


def leave_out_lines(survey: PhotogrammetryMeasurement, first: FirstLook, known: KnownTargets) -> CheckedList:
    """Leave out photos whose targets are all on one line, as those of one rim: the camera may be anywhere around it.

    first: What was found in the photos.
    known: Those whose coordinates are listed.
    Returns: Without those photos. A photo with targets that are not listed is kept: others may determine them.
    """
    place = dict(zip(known.names, known.points_m, strict=True))
    on_line = set()
    for one in first.targets:
        names = one.detections.names
        listed = np.array([place[name] for name in names if name in place]).reshape(-1, 3)
        if len(listed) == len(names) >= LEAST_TARGETS and not spans_an_area(listed):
            on_line.add(one.detections.photo)
    if not on_line:
        return CheckedList(survey, first)
    targets = tuple(one for one in first.targets if one.detections.photo not in on_line)
    poses = {name: pose for name, pose in first.poses.items() if name not in on_line}
    files = tuple(file for file in survey.photo_files if file.name not in on_line)
    doubt = Doubt(
        "photos_with_targets_on_a_line",
        f"{len(on_line)} photos show targets along one line only, as those of one rim, which determine no pose, and "
        f"were left out: {', '.join(sorted(on_line)[:5])}{' ...' if len(on_line) > 5 else ''}",
        {"photos_count": len(on_line)},
    )
    return CheckedList(replace(survey, photo_files=files), replace(first, targets=targets, poses=poses), (doubt,))


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
    """Refuse a list of targets that does not determine where the trough's frame lies, or turns it upside down.

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


def leave_out_strays(found: CheckedList, finder: Finder) -> CheckedList:
    """Leave out the coordinates of targets that the photos show elsewhere, as where two were exchanged in the list.

    Returns: Without those coordinates; the targets are measured like others that are not listed.
    """
    known, survey, first = finder.known, found.survey, found.first
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
        return found
    usual = np.array([float(np.median(off[number])) for number in shown])
    step = float(np.median(pixel_m))
    which = stray_targets(usual, np.hypot(_POINT_PX, known.sigma_m[shown] / step))
    if not which.any():
        return found
    names = [known.names[number] for number, stray in zip(shown, which, strict=True) if stray]
    kept = tuple(
        one for one in survey.model.constraint if not (isinstance(one, CoordinateSection) and one.target in names)
    )
    listed = ", ".join(f"{name} ({1e3 * step * far:.0f} mm)" for name, far in zip(names, usual[which], strict=True))
    doubt = Doubt(
        "targets_not_where_listed",
        f"targets: not where the list has them: {listed}; their coordinates were not used. Were two exchanged, one "
        "moved, or a number mistyped?",
        {"targets_count": len(names)},
    )
    survey = replace(survey, model=survey.model.model_copy(update={"constraint": kept}))
    return CheckedList(survey, first, (*found.doubts, doubt))
