"""The list of targets beside what the photos show: known places, photos and entries left out, lists refused."""

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.validate import FloatArray
from observer.pipeline.inputs import AXES
from observer.pipeline.reading.photos import Finder, FirstLook
from observer.targets.contradictions import Contradiction, find_contradiction
from observer.targets.list_checks import (
    exchanged_pairs,
    free_axis,
    intersect,
    refuse_loose_frame,
    refuse_strange_targets,
    refuse_upside_down,
    stray_targets,
)
from observer.targets.list_focal import FocalOfList, focal_of_list, refuse_other_focal
from observer.trough.collector import Collector
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.bundle import constraints, statistics
from photogrammetry.keys import CoordinateSection, PhotogrammetryMeasurement
from photogrammetry.matching import KnownTargets
from photogrammetry.start_values import LEAST_TARGETS, spans_an_area

#: Where a target is in a photo before all are adjusted: pose and centre together [px].
_POINT_PX = 0.3
#: Of two photos either may be the one of another size.
_LEAST_OF_SIZE = 3


@dataclass(frozen=True, slots=True, eq=False)
class CheckedList:
    """The photo network and what was found in its photos, without what contradicts the list of targets.

    doubts: What was left out before the adjustment.
    contradicted: Listed places that the adjustment of the others contradicts; they are not in the network.
    """

    survey: PhotogrammetryMeasurement
    first: FirstLook
    doubts: tuple[Doubt, ...] = ()
    contradicted: tuple[CoordinateSection, ...] = ()

    @property
    def contradicted_targets(self) -> tuple[str, ...]:
        """Targets whose listed places are contradicted."""
        return tuple(dict.fromkeys(one.target for one in self.contradicted))

    def without_places(self, targets: Container[str]) -> "CheckedList":
        """Return the same without listed places that the others contradict."""
        out = [
            one for one in self.survey.model.constraint if isinstance(one, CoordinateSection) and one.target in targets
        ]
        return replace(self, survey=without_places(self.survey, targets), contradicted=(*self.contradicted, *out))


def check_list(survey: PhotogrammetryMeasurement, finder: Finder, file: str, first: FirstLook) -> CheckedList:
    """Leave out photos that determine no pose and coordinates that the photos contradict.

    file: Name of the list, for messages.
    first: What was found in the photos.
    InputError: The list is not that of the targets in the photos.
    """
    sized = leave_out_other_size(survey, first, finder)
    found = leave_out_lines(sized.survey, sized.first, finder.known)
    found = replace(found, doubts=(*sized.doubts, *found.doubts))
    refuse_strange_list(found.survey, found.first, file)
    for camera in dict.fromkeys(finder.camera_of.values()):
        refuse_other_focal(focal_of_photos(found.first, finder, camera, unless_stated_fits=True), camera)
    found = leave_out_strays(found, finder)
    count = len(first.by_list)
    if not count:
        return found
    text = (
        f"{count} photos show too few codes that can be read for their pose; it was found from the places of the other "
        f"targets in the list: {', '.join(first.by_list[:5])}{' ...' if count > 5 else ''}"
    )
    note = Doubt("photos_placed_by_list", text, {"photos_count": count}, Severity.NOTE)
    return replace(found, doubts=(*found.doubts, note))


def focal_of_photos(
    first: FirstLook, finder: Finder, camera: Camera, *, unless_stated_fits: bool = False
) -> FocalOfList | None:
    """Return the focal length that a camera's photos of the listed targets show by themselves.

    camera: One of the finder's; where it has none, a guess with the photos' size.
    unless_stated_fits: Whether another one is looked for only where that of the camera does not fit the targets.
    """
    place = {name: number for number, name in enumerate(finder.known.names)}
    photos = []
    for one in first.targets:
        table = one.detections
        if finder.camera_of.get(table.photo, camera) is camera:
            rows = [k for k, name in enumerate(table.names) if name in place and table.usable[k]]
            own = [place[table.names[k]] for k in rows]
            photos.append((finder.known.points_m[own], table.pixels_px[rows]))
    return focal_of_list(photos, camera, unless_stated_fits=unless_stated_fits)


def keep_placed(survey: PhotogrammetryMeasurement, first: FirstLook) -> CheckedList:
    """Return the network of photos whose corners were found; what is known of these is the drawing, no list."""
    files = tuple(file for file in survey.photo_files if file.name in first.poses)
    if len(files) == len(survey.photo_files):
        return CheckedList(survey, first)
    lost = [one.refused[0] for one in first.targets if one.detections.photo not in first.poses]
    shown = "; ".join(f"{one.name}: {one.reason.removeprefix('left out: ')}" for one in lost[:3])
    text = f"{len(lost)} of {len(survey.photo_files)} photos were left out: {shown}{' ...' if len(lost) > 3 else ''}"
    doubt = Doubt("photos_without_corners", text, {"photos_count": len(lost)}, Severity.NOTE)
    return CheckedList(replace(survey, photo_files=files), first, (doubt,))


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
    doubt = Doubt(
        "photos_with_targets_on_a_line",
        f"{len(on_line)} photos show targets along one line only, as those of one rim, which determine no pose, and "
        f"were left out: {', '.join(sorted(on_line)[:5])}{' ...' if len(on_line) > 5 else ''}",
        {"photos_count": len(on_line)},
    )
    return _without(survey, first, on_line, doubt)


def leave_out_other_size(survey: PhotogrammetryMeasurement, first: FirstLook, finder: Finder) -> CheckedList:
    """Leave out the only photo that is not of the stated camera's size; where there are more the camera is refused.

    first: What was found in the photos.
    """
    sizes = {one.detections.photo: one.size_px for one in first.targets}
    doubt = other_size_doubt(sizes, finder)
    return CheckedList(survey, first) if doubt is None else _without(survey, first, {doubt[0]}, doubt[1])


def other_size_doubt(sizes_px: Mapping[str, tuple[int, int]], finder: Finder) -> tuple[str, Doubt] | None:
    """Say which photo alone is not of the stated camera's size, by its name; None where none is, or several are.

    sizes_px: Width and height of each photo.
    """
    cameras = {name: finder.camera_of[name] for name in sizes_px if name in finder.camera_of}
    own = {name: (one.width_px, one.height_px) for name, one in cameras.items()}
    odd = [name for name, size in own.items() if sizes_px[name] != size]
    if len(odd) != 1 or len(own) < _LEAST_OF_SIZE:
        return None
    width, height = sizes_px[odd[0]]
    text = (
        f"photo {odd[0]} has another size than the others ({width} x {height} px against {own[odd[0]][0]} x "
        f"{own[odd[0]][1]} px): not of this camera, and left out: remove it (or describe several cameras with "
        "[[camera]] and photos)"
    )
    return odd[0], Doubt("photo_of_another_size", text, {"width_px": width, "height_px": height})


def _without(survey: PhotogrammetryMeasurement, first: FirstLook, names: Container[str], doubt: Doubt) -> CheckedList:
    """Leave out photos, and say so."""
    targets = tuple(one for one in first.targets if one.detections.photo not in names)
    poses = {name: pose for name, pose in first.poses.items() if name not in names}
    files = tuple(file for file in survey.photo_files if file.name not in names)
    return CheckedList(replace(survey, photo_files=files), replace(first, targets=targets, poses=poses), (doubt,))


def refuse_strange_list(survey: PhotogrammetryMeasurement, first: FirstLook, file: str) -> None:
    """Refuse a list whose targets are not those in the photos, before they are adjusted.

    first: What was found in the photos.
    InputError: Fewer than three listed targets are seen.
    """
    listed = dict.fromkeys(one.target for one in survey.model.constraint if isinstance(one, CoordinateSection))
    seen = [name for one in first.targets for name in one.detections.names]
    refuse_strange_targets(tuple(listed), seen, file)


def refuse_loose_list(network: photogrammetry_pipeline.Result, listed: CheckedList, collector: Collector) -> None:
    """Refuse a list of targets that does not determine where the trough's frame lies, or turns it upside down.

    InputError: z has the wrong sign.
    EstimationError: The frame is free to turn.
    """
    points_m, sigma_m = _listed_places(network, listed.survey)
    refuse_loose_frame(points_m, sigma_m, listed.contradicted_targets)
    refuse_upside_down(points_m, collector)


def _listed_places(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement
) -> tuple[FloatArray, FloatArray]:
    """Return adjusted places of listed targets and sigmas of their listed coordinates, NaN: none; (n, 3) each [m]."""
    table = network.points
    row = {name: number for number, name in enumerate(table.ids)}
    sigma = np.full((len(row), 3), np.nan)
    for one in survey.model.constraint:
        if isinstance(one, CoordinateSection) and one.target in row:
            sigma[row[one.target], AXES.index(one.axis)] = 1e-3 * one.sigma_mm
    for known in survey.known:
        if isinstance(known, constraints.KnownPlaces):
            for name, own in zip(known.targets, np.sqrt(np.diag(known.covariance_m2)).reshape(-1, 3), strict=True):
                if name in row:
                    sigma[row[name]] = own
    used = np.isfinite(sigma).any(axis=1) & np.isfinite(table.xyz_m).all(axis=1)
    return table.xyz_m[used], sigma[used]


def leave_out_strays(found: CheckedList, finder: Finder) -> CheckedList:
    """Set right entries of the list that were exchanged, and leave out coordinates that the photos contradict.

    Returns: Without those coordinates; the targets are measured like others that are not listed. Two that were
        exchanged have each other's coordinates.
    """
    known, survey, first = finder.known, found.survey, found.first
    sights = _sights(known, first, finder)
    shown = np.flatnonzero([len(rays) > 0 for rays in sights.miss_px])
    if not shown.size:
        return found
    usual = np.array([float(np.median(sights.miss_px[number])) for number in shown])
    step = sights.pixel_m
    which = stray_targets(usual, np.hypot(_POINT_PX, known.sigma_m[shown] / step))
    if not which.any():
        return found
    stray = shown[which]
    seen = {int(number): place for number in stray if (place := intersect(*sights.rays(int(number)))) is not None}
    plain = [
        number for number, name in enumerate(known.names) if name in finder.kinds.plain and not sights.miss_px[number]
    ]
    pairs = exchanged_pairs(seen, known.points_m, known.sigma_m, _POINT_PX * step, plain)
    swapped = {known.names[a]: known.names[b] for pair in pairs for a, b in (pair, pair[::-1])}
    left = [known.names[number] for number in stray if known.names[number] not in swapped]
    doubts = []
    if pairs:
        said = "; ".join(f"{known.names[a]} and {known.names[b]}" for a, b in pairs)
        text = (
            f"targets: exchanged in the list: {said}; the photos show each where the list has the other, and so they "
            "were used. Mend the list"
        )
        doubts.append(Doubt("targets_exchanged", text, {"targets_count": 2 * len(pairs)}))
    if left:
        far = dict(zip((known.names[number] for number in stray), usual[which], strict=True))
        listed = ", ".join(f"{name} ({1e3 * step * far[name]:.0f} mm)" for name in left)
        text = (
            f"targets: not where the list has them: {listed}; their coordinates were not used. Has one moved, or was a "
            "number mistyped?"
        )
        doubts.append(Doubt("targets_not_where_listed", text, {"targets_count": len(left)}))
    renamed = tuple(
        one.model_copy(update={"target": swapped.get(one.target, one.target)})
        if isinstance(one, CoordinateSection)
        else one
        for one in survey.model.constraint
    )
    survey = replace(survey, model=survey.model.model_copy(update={"constraint": renamed}))
    return CheckedList(without_places(survey, left), first, (*found.doubts, *doubts))


def without_places(survey: PhotogrammetryMeasurement, targets: Container[str]) -> PhotogrammetryMeasurement:
    """Return the network without the listed coordinates of some targets, which are measured like any other."""
    kept = tuple(
        one for one in survey.model.constraint if not (isinstance(one, CoordinateSection) and one.target in targets)
    )
    return replace(survey, model=survey.model.model_copy(update={"constraint": kept}))


def contradicted_places(network: photogrammetry_pipeline.Result, listed: CheckedList) -> Contradiction | None:
    """Return which listed targets contradict the others as adjusted; None where the list agrees with itself.

    Returns: Told only where the others determine the trough's frame.
    """
    bundle = network.solved.bundle
    residuals = dict(bundle.constraint_residuals)
    known = [one for one in bundle.problem.constraints if isinstance(one, constraints.Coordinate)]
    if not known:
        return None
    redundancy = statistics.coordinates_redundancy(bundle, known)
    fine = np.flatnonzero(np.isfinite(np.diag(redundancy)))
    over_sigma = np.array([residuals[known[k].name][0] for k in fine])
    names = [known[k].target for k in fine]
    found = find_contradiction(names, over_sigma, redundancy[np.ix_(fine, fine)], len(listed.contradicted_targets))
    if found is None or not found.told:
        return found
    left = without_places(listed.survey, found.targets)
    return replace(found, told=free_axis(*_listed_places(network, left)) is None)


def contradicted_doubt(
    listed: CheckedList, network: photogrammetry_pipeline.Result, rest: Contradiction | None
) -> Doubt | None:
    """Say which listed places contradict the others, and where the photos show those that were left out.

    network: As adjusted without them.
    rest: What the places that were used contradict.
    """
    said = []
    if listed.contradicted:
        out = ", ".join(_how_far_off(listed, network))
        said.append(f"the photos contradict the listed place of {out}; it was not used")
    if rest is None and not said:
        return None
    if rest is None:
        said[0] += ", all others agree"
    else:
        which = f"any of {', '.join(rest.targets)}" if len(rest.targets) > 1 else f"that of {rest.targets[0]}"
        said.append(
            f"listed places contradict each other; {which} may be wrong, which cannot be told: they were used, and the "
            "trough's frame may be turned"
        )
    text = (
        f"targets: {'; '.join(said)}. Has one moved, or was a number mistyped? Mend the list, or make its cells empty"
    )
    count = len(listed.contradicted_targets) + (0 if rest is None else len(rest.targets))
    severity = Severity.DOUBT if rest is None else Severity.SERIOUS
    return Doubt("targets_contradict_list", text, {"targets_count": count}, severity)


def _how_far_off(listed: CheckedList, network: photogrammetry_pipeline.Result) -> Iterator[str]:
    """Yield how far each target that was left out is from its listed place, where it is off most."""
    found = dict(zip(network.points.ids, network.points.xyz_m, strict=True))
    for name in listed.contradicted_targets:
        place = found.get(name, np.full(3, np.nan))
        off_mm = {
            one.axis: 1e3 * float(place[AXES.index(one.axis)] - one.value_m)
            for one in listed.contradicted
            if one.target == name
        }
        axis = max(off_mm, key=lambda axis: abs(off_mm[axis]))
        yield f"target {name} ({off_mm[axis]:+.1f} mm in {axis})" if np.isfinite(place).all() else f"target {name}"


@dataclass(frozen=True, slots=True, eq=False)
class _Sights:
    """Where photos show the listed targets.

    miss_px: Of each target how far it is from where the pose of each photo has it [px].
    eyes_m, lines: Of each target the cameras' places and the directions in which they see it [m].
    pixel_m: What a pixel is at the targets of a usual photo [m].
    """

    miss_px: list[list[float]]
    eyes_m: list[list[FloatArray]]
    lines: list[list[FloatArray]]
    pixel_m: float

    def rays(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return places and directions of the lines of sight to a target, (n, 3) each."""
        return np.reshape(self.eyes_m[number], (-1, 3)), np.reshape(self.lines[number], (-1, 3))


def _sights(known: KnownTargets, first: FirstLook, finder: Finder) -> _Sights:
    place = {name: number for number, name in enumerate(known.names)}
    count, pixel_m = len(known.names), []
    miss: list[list[float]] = [[] for _ in range(count)]
    eyes: list[list[FloatArray]] = [[] for _ in range(count)]
    lines: list[list[FloatArray]] = [[] for _ in range(count)]
    for one in first.targets:
        table = one.detections
        pose, camera = first.poses.get(table.photo), finder.camera_of.get(table.photo)
        rows = [k for k, name in enumerate(table.names) if name in place and table.usable[k]]
        if pose is None or camera is None or not rows:
            continue
        own = [place[table.names[k]] for k in rows]
        seen = pose.apply(known.points_m[own])
        off = np.linalg.norm(camera.project(seen) - table.pixels_px[rows], axis=1)
        back = pose.inverse()
        for number, far, line in zip(
            own, off.tolist(), back.rotate(camera.cast_rays(table.pixels_px[rows])), strict=True
        ):
            miss[number].append(far)
            eyes[number].append(back.translation_m)
            lines[number].append(line)
        pixel_m.append(float(np.median(seen[:, 2])) / camera.focal_x_px)
    return _Sights(miss, eyes, lines, float(np.median(pixel_m)) if pixel_m else 0.0)
