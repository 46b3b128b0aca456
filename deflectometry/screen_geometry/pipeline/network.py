"""Photos of a screen to one adjusted network of targets and dots, and from it the points of the screen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.dots.found_dots import FoundDots, find_dots
from deflectometry.dots.ground import POLARITIES, ground_of_dots
from deflectometry.dots.origin import find_light, number_at
from deflectometry.screen_geometry.keys import ScreenMeasurement, WallDotsSection
from deflectometry.screen_geometry.numbering import DotView, number_alike
from deflectometry.screen_geometry.screen_shape import ScreenPoints
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import read_image
from heliogauge.results.tables import read_table_csv
from heliogauge.running.progress import Progress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry import ImagePoints
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.bundle import BundleResult
from photogrammetry.bundle import state as states
from photogrammetry.detection import TargetSearch
from photogrammetry.keys import NetworkCameraSection, PhotogrammetryMeasurement, TargetsSection
from photogrammetry.pipeline import MeasuredPhotos, OnePhoto, build_search, collect_photos, measure_photo
from photogrammetry.start_values import StartValues

#: A dot must be seen in so many photos to be measured with a check.
_LEAST_PHOTOS = 2
#: Up to so many photos a camera that calibrates itself may be the reason why nothing fits: see the how-to.
_FEW_PHOTOS = 4
#: So many markers at the rims place a photo by their middles alone; of fewer the corners say how it is turned.
_LEAST_MARKERS = 8


#: Photos with fewer targets are looked at in a mirror, and are mirrored when that shows so many times more: codes are
#: made to be told apart from their mirror images, so that hardly one is read by chance.
_FEW_TARGETS, _MIRRORED = 16, 3


@dataclass(frozen=True, slots=True, eq=False)
class Seen(ShortRepr):
    """What the photos show.

    targets: Coded targets, as photogrammetry has them.
    dots: Dots of each photo that shows the field, by its own lattice.
    lights: Numbers of the dot beside a light, in the photo's own lattice; where one was looked for and found.
    doubts: What is doubtful of the photos.
    """

    targets: MeasuredPhotos
    dots: dict[str, FoundDots]
    lights: dict[str, IntArray]
    doubts: tuple[Doubt, ...]


def see(measurement: ScreenMeasurement, progress: Progress) -> Seen:
    """Find targets and dots in all photos.

    InputError: Photos or tables that cannot be used.
    EstimationError: No targets, or fewer than two photos with dots.
    """
    section, model = measurement.network.model.targets, measurement.model
    if section is None:
        raise InputError("[targets] is missing")
    search = build_search(section, measurement.folder)
    found: list[OnePhoto] = []
    dots, lights, without = {}, {}, []
    with progress.stage("measure photos", len(measurement.photo_files)) as stage:
        for file in measurement.photo_files:
            image = read_image(file)
            found.append(measure_photo(image, file.name, section, search))
            if model.dots is not None:
                try:
                    own = _dots_of(image, model.dots)
                except EstimationError as error:
                    without.append(f"{file.name} ({error})")
                else:
                    dots[file.name] = own
                    if model.dots.origin == "light":
                        place = _light(image, own, model.dots)
                        if place is not None:
                            lights[file.name] = place
            stage.advance()
    _refuse_mirrored(measurement, found, section, search)
    if model.dots is not None and len(dots) < _LEAST_PHOTOS:
        raise EstimationError(
            f"{len(dots)} of {len(found)} photos show the field of dots, {_LEAST_PHOTOS} are needed: "
            + "; ".join(without)
        )
    doubts: tuple[Doubt, ...] = ()
    if without:
        text = f"{len(without)} of {len(found)} photos give no dots: {'; '.join(without)}"
        doubts = (Doubt("photos_without_dots", text, {"photos_count": len(without)}),)
    return Seen(collect_photos(found), dots, lights, doubts)


def _refuse_mirrored(
    measurement: ScreenMeasurement, found: Sequence[OnePhoto], section: TargetsSection, search: TargetSearch
) -> None:
    """Refuse photos in whose mirror images more targets are read than in themselves.

    Only photos with few targets are looked at again. A code is read in mirrored form by chance, if at all.
    """
    counts = [len(one.detections.names) for one in found]
    few = max(_FEW_TARGETS, max(counts, default=0) // 2)
    mirrored = []
    for file, count in zip(measurement.photo_files, counts, strict=True):
        if count < few:
            turned: Any = np.ascontiguousarray(read_image(file)[:, ::-1])
            again = len(measure_photo(turned, file.name, section, search).detections.names)
            if again > max(_MIRRORED * count, _FEW_TARGETS // 2):
                mirrored.append(f"{file.name} ({again} targets when mirrored back, {count} as it is)")
    if mirrored:
        raise EstimationError(
            f"{len(mirrored)} of {len(found)} photos are mirrored: {'; '.join(mirrored)}; give the photos as the "
            "camera took them, not of a mirror image and not flipped"
        )


def _dots_of(image: npt.NDArray[Any], section: WallDotsSection) -> FoundDots:
    return find_dots(image, np.ones(image.shape, dtype=np.bool_), POLARITIES[section.dots])


def _light(image: npt.NDArray[Any], dots: FoundDots, section: WallDotsSection) -> IntArray | None:
    """Return the number of the dot beside the light; None where no light stands out."""
    try:
        place = find_light(image, ground_of_dots(image, dots, POLARITIES[section.dots]), _hull(image, dots))
        return number_at(dots, place)
    except EstimationError:
        return None


def _hull(image: npt.NDArray[Any], dots: FoundDots) -> BoolArray:
    """Return the pixels between the dots, shape (h, w)."""
    import cv2

    mask = np.zeros(image.shape, dtype=np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(dots.centers_px).astype(np.int32)), 1)
    return np.asarray(mask, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class ScreenNetwork(ShortRepr):
    """The adjusted network of a screen.

    result: Photogrammetry's.
    number (n, 2): Column and row of each dot that was measured; empty for a display with coded targets.
    points: The points of the screen.
    origin: What says which dot is (0, 0), in words.
    doubts: Those of photos, network and numbering.
    own_frame: Whether the points do not depend on the network's frame.
    """

    result: photogrammetry_pipeline.Result
    number: IntArray
    points: ScreenPoints
    origin: str
    doubts: tuple[Doubt, ...]
    own_frame: bool


def solve(
    measurement: ScreenMeasurement,
    seen: Seen,
    progress: Progress,
    listed: tuple[list[str], FloatArray, FloatArray] | None = None,
) -> ScreenNetwork:
    """Adjust the network and take the points of the screen from it.

    listed: Names and fractions of a display's targets; default: from its table.
    InputError: Tables that cannot be used.
    EstimationError: The photos do not hang together, or do not say which dot is which.
    """
    model = measurement.model
    if model.display is not None:
        names, u, v = listed or read_display(measurement.folder / model.display.file)
        _refuse_other_table(model.display.file, names, seen.targets)
    try:
        alone = photogrammetry_pipeline.run(measurement.network, None, progress, measured=seen.targets)
    except EstimationError as error:
        raise _with_count_of_photos(measurement, error) from None
    if model.display is not None:
        points = _with_middles(seen.targets, names, alone.solved.bundle)
        again = alone if points is None else _again(measurement, alone, points, progress)
        return _of_targets(measurement, again, seen, (names, u, v))
    names, numbers, origin, doubts = _numbered(measurement, seen, alone.solved.bundle)
    joint = _again(measurement, alone, _joined(seen.targets, names, numbers, seen.dots), progress)
    bundle = joint.solved.bundle
    place = {name: k for k, name in enumerate(bundle.problem.observations.targets)}
    every = np.unique(np.concatenate(numbers), axis=0)
    enough = bundle.problem.observations.n_rays
    chosen = np.array(
        [one for one in every.tolist() if enough[place.get(_name(one), 0)] >= _LEAST_PHOTOS and _name(one) in place]
    )
    index = np.array([place[_name(one)] for one in chosen.tolist()], dtype=np.intp)
    low, high = chosen.min(axis=0), chosen.max(axis=0)
    u, v = (chosen[:, 0] - low[0]) / (high[0] - low[0]), (high[1] - chosen[:, 1]) / (high[1] - low[1])
    gathered = (*seen.doubts, *joint.doubts, *doubts)
    found = _screen_points(measurement, bundle, index, u, v)
    own_frame = model.shape.frame == "screen"
    return ScreenNetwork(joint, chosen, found, origin, gathered, own_frame)


def _refuse_other_table(file: str, names: Sequence[str], targets: MeasuredPhotos) -> None:
    """Refuse a table of which the photos show fewer than three targets."""
    shown = set(targets.points.targets)
    missing = [name for name in names if name not in shown and not shown.issuperset(_corners(name))]
    if len(names) - len(missing) < 3:
        raise EstimationError(
            f"{len(names) - len(missing)} of the {len(names)} targets of {file} are in the photos, 3 are needed; not "
            f"there: {', '.join(missing[:8])}; is it the table of this screen?"
        )


def _with_count_of_photos(measurement: ScreenMeasurement, error: EstimationError) -> EstimationError:
    """Say with a failed network that too few photos are there for cameras that calibrate themselves."""
    count = len(measurement.photo_files)
    free = [one.name for one in measurement.model.camera if "focal_px" in one.estimated]
    if count > _FEW_PHOTOS or not free:
        return error
    told = EstimationError(
        f"{error}; {count} photos are few for a camera that calibrates itself ({', '.join(free)}): take five to eight "
        "from different sides, two of them turned by 90 degrees, or give its calibration (file or focal_px)"
    )
    told.pictures = error.pictures
    return told


def _again(
    measurement: ScreenMeasurement, before: photogrammetry_pipeline.Result, points: MeasuredPhotos, progress: Progress
) -> photogrammetry_pipeline.Result:
    """Adjust other image points of the same photos, from their poses and cameras."""
    network, is_start = _with_found_cameras(measurement.network, before.solved.bundle)
    start = StartValues(_poses(before.solved.bundle), {}) if is_start else None
    return photogrammetry_pipeline.run(network, None, progress, measured=points, start=start)


def _with_middles(targets: MeasuredPhotos, names: Sequence[str], bundle: BundleResult) -> MeasuredPhotos | None:
    """Return the image points with the middle of each whole marker of the display in the place of its corners.

    names: What the display's table names; a name without a corner's number is a marker.
    bundle: The network of the corners.
    Returns: None where too few markers are whole: then their corners are needed.

    The four corners of a marker in a photo share its four edges. An edge's line is known to s in its middle, to 2 s at
    its ends, and there with a correlation of -1/2 between them: taken as independent, corners make the middle of a
    marker, and with it all of the screen, twice as uncertain (in variance) as it is.
    """
    points, table = targets.points, bundle.problem.observations
    listed = np.array(points.targets)[points.target_index]
    photos = np.array(points.photos)[points.photo_index]
    place = {name: k for k, name in enumerate(table.targets)}
    row_of = {key: row for row, key in enumerate(zip(photos.tolist(), listed.tolist(), strict=True))}
    found: list[tuple[str, str, FloatArray, FloatArray]] = []
    for number, photo in enumerate(table.photos):
        lens = bundle.state.cameras[int(bundle.problem.camera_index[number])]
        for name in names:
            corners = _corners(name)
            if name in place or not all(one in place and (photo, one) in row_of for one in corners):
                continue
            rows = [row_of[photo, one] for one in corners]
            # The mean of the corners, put right for perspective and lens. Where the diagonals meet would need no such
            # correction, but turned edges move it: it has four times the variance.
            xyz = bundle.cam_from_world[number].apply(bundle.state.points_m[[place[one] for one in corners]])
            bent = lens.project(xyz.mean(axis=0, keepdims=True))[0] - lens.project(xyz).mean(axis=0)
            pixel = points.pixels_px[rows].mean(axis=0) + bent
            found.append((photo, name, pixel, points.covariance_px2[rows].sum(axis=0) / 32))
    if len({one[1] for one in found}) < _LEAST_MARKERS:
        return None
    knowledge = bundle.problem
    kept = {one for constraint in knowledge.constraints for one in constraint.targets}
    kept |= {*knowledge.fixed, *knowledge.datum.targets, *names}
    replaced = {corner for one in found for corner in _corners(one[1])} - kept
    keep = ~np.isin(listed, sorted(replaced))
    kinds = np.zeros(points.n, dtype=np.intp) if targets.kinds is None else targets.kinds
    return replace(
        targets,
        points=ImagePoints.from_names(
            [*photos[keep].tolist(), *(one[0] for one in found)],
            [*listed[keep].tolist(), *(one[1] for one in found)],
            np.concatenate([points.pixels_px[keep], [one[2] for one in found]]),
            np.concatenate([points.covariance_px2[keep], [one[3] for one in found]]),
        ),
        ellipses_px2=np.concatenate([targets.ellipses_px2[keep], np.full((len(found), 2, 2), np.nan)]),
        # Of the same kind as corners, with the ratio derived above: a few corners would not tell their own size.
        kinds=np.concatenate([kinds[keep], np.full(len(found), int(kinds.max(initial=0)))]),
    )


def _with_found_cameras(
    network: PhotogrammetryMeasurement, bundle: BundleResult
) -> tuple[PhotogrammetryMeasurement, bool]:
    """Return the network with the cameras that calibrated themselves as they were found, and whether all are.

    Poses that go with a camera as it was found are no start for the same camera as it was stated.
    """
    found = {one.name: (one, camera) for one, camera in zip(bundle.problem.cameras, bundle.state.cameras, strict=True)}
    sections, all_found = [], True
    for section in network.model.camera:
        model, camera = found.get(section.name, (None, None))
        if model is None or camera is None or not model.free:
            sections.append(section)
        elif section.file is not None or section.millimetres is not None:
            sections.append(section)
            all_found = False
        else:
            values = dict(zip(states.INTRINSIC_NAMES, states.intrinsics_of(camera).tolist(), strict=True))
            size = {"width_px": camera.width_px, "height_px": camera.height_px}
            direction = {"distortion_direction": str(camera.distortion.direction)}
            stated = section.model_dump(exclude_unset=True) | values | size | direction | {"free": model.free}
            stated.pop("focal_length_35mm", None)
            sections.append(NetworkCameraSection.model_validate(stated))
    return replace(network, model=network.model.model_copy(update={"camera": tuple(sections)})), all_found


def _name(number: Sequence[int]) -> str:
    return f"dot {number[0]} {number[1]}"


def _poses(bundle: BundleResult) -> dict[str, Any]:
    return dict(zip(bundle.problem.observations.photos, bundle.cam_from_world, strict=True))


def _numbered(
    measurement: ScreenMeasurement, seen: Seen, bundle: BundleResult
) -> tuple[list[str], list[IntArray], str, tuple[Doubt, ...]]:
    """Return the photos with dots, the numbers of their dots, what says the origin, and doubts."""
    section = measurement.model.dots
    if section is None:
        raise InputError("[dots] is missing")
    poses, owners = _poses(bundle), bundle.problem
    cameras = dict(zip(owners.observations.photos, owners.camera_index.tolist(), strict=True))
    names = [name for name in seen.dots if name in poses]
    if len(names) < _LEAST_PHOTOS:
        raise EstimationError(
            f"{len(names)} of the photos with dots hang together by their targets; {_LEAST_PHOTOS} are needed"
        )
    views = [DotView(name, seen.dots[name], bundle.state.cameras[cameras[name]], poses[name]) for name in names]
    numbers = list(number_alike(views, bundle.points_m[np.isfinite(bundle.points_m).all(axis=1)]))
    doubts: tuple[Doubt, ...] = ()
    if section.known_dot is not None:
        known = section.known_dot
        if known.photo not in names:
            raise InputError(f"dots.known_dot.photo = {known.photo!r}: no dots were found in this photo")
        own = seen.dots[known.photo].renumbered(numbers[names.index(known.photo)])
        zero = number_at(own, np.array(known.image_px)) - (known.column, known.row)
        origin = f"the known dot in {known.photo}"
    elif section.origin == "light":
        lit = {}
        for name, its in zip(names, numbers, strict=True):
            if name in seen.lights:
                at = np.flatnonzero((seen.dots[name].number == seen.lights[name]).all(axis=1))
                if at.size:
                    lit[name] = tuple(its[at[0]].tolist())
        zero, doubts = _agreed(lit, len(names))
        origin = f"the light beside it, in {len(lit)} of {len(names)} photos"
    else:
        zero = np.concatenate(numbers).min(axis=0)
        origin = "the lower left one"
    return names, [own - zero for own in numbers], origin, doubts


def _agreed(lit: dict[str, tuple[int, ...]], count: int) -> tuple[IntArray, tuple[Doubt, ...]]:
    """Return the dot beside the light by most photos."""
    if not lit:
        raise EstimationError(
            f"no light stands out beside a dot in any of {count} photos; give [dots.known_dot], or origin = "
            '"corner" to count from the lower left dot'
        )
    places, votes = np.unique(np.array(list(lit.values())), axis=0, return_counts=True)
    best = int(np.argmax(votes))
    if 2 * votes[best] <= len(lit):
        raise EstimationError(
            f"the photos do not agree on the dot beside the light ({len(places)} places in {len(lit)} photos); cover "
            "other bright spots, or give [dots.known_dot]"
        )
    if len(places) == 1:
        return places[best], ()
    odd = [name for name, place in lit.items() if place != tuple(places[best].tolist())]
    text = f"in {', '.join(odd)} another dot than in the other {votes[best]} photos is beside the brightest spot"
    return places[best], (Doubt("light_beside_other_dot", text, {"photos_count": len(odd)}),)


def _joined(
    targets: MeasuredPhotos, names: Sequence[str], numbers: Sequence[IntArray], dots: dict[str, FoundDots]
) -> MeasuredPhotos:
    """Return the image points of the targets and of the dots."""
    points: ImagePoints = targets.points
    photos = [points.photos[k] for k in points.photo_index.tolist()]
    labels = [points.targets[k] for k in points.target_index.tolist()]
    places, covariances = [points.pixels_px], [points.covariance_px2]
    # The middle of a dot's ellipse is not the image of its centre: 0.005 px here, all dots of a photo to one side.
    shapes = [targets.ellipses_px2]
    for name, number in zip(names, numbers, strict=True):
        labels += [_name(one) for one in number.tolist()]
        photos += [name] * len(number)
        places.append(dots[name].centers_px)
        covariances.append(dots[name].covariance_px2)
        own = dots[name].shapes_px2
        shapes.append(np.full((len(number), 2, 2), np.nan) if own is None else own)
    covariance = np.concatenate(covariances)
    joined = ImagePoints.from_names(
        photos, labels, np.concatenate(places), 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
    )
    more = joined.n - points.n
    kinds = np.zeros(points.n, dtype=np.intp) if targets.kinds is None else targets.kinds
    return replace(
        targets,
        points=joined,
        ellipses_px2=np.concatenate(shapes),
        kinds=np.concatenate([kinds, np.full(more, int(kinds.max(initial=0)) + 1)]),
    )


def _of_targets(
    measurement: ScreenMeasurement,
    result: photogrammetry_pipeline.Result,
    seen: Seen,
    listed: tuple[list[str], FloatArray, FloatArray],
) -> ScreenNetwork:
    """Return the points of a display that coded targets at its rims mark.

    listed: Names and fractions of the display's table.
    """
    section = measurement.model.display
    if section is None:
        raise InputError("[display] is missing")
    bundle = result.solved.bundle
    names, u, v = listed
    place = {name: k for k, name in enumerate(bundle.problem.observations.targets)}
    # The middle of a marker itself, else its four corners.
    groups = [
        [place[name]] if name in place else [place[one] for one in _corners(name) if one in place] for name in names
    ]
    whole = [
        len(group) in (1, 4) and len(group) == (4 if name not in place else 1)
        for name, group in zip(names, groups, strict=True)
    ]
    if sum(whole) < 3:
        missing = [name for name, fine in zip(names, whole, strict=True) if not fine]
        raise EstimationError(
            f"{sum(whole)} of the {len(names)} targets of {section.file} are in the network, 3 are needed; not there: "
            f"{', '.join(missing[:8])}"
        )
    fine = np.array(whole)
    chosen = [group for group, is_whole in zip(groups, whole, strict=True) if is_whole]
    flat = np.array([one for group in chosen for one in group], dtype=np.intp)
    points = _screen_points(measurement, bundle, flat, np.zeros(flat.size), np.zeros(flat.size))
    mean = np.zeros((len(chosen), flat.size))
    first = 0
    for row, group in enumerate(chosen):
        mean[row, first : first + len(group)] = 1.0 / len(group)
        first += len(group)
    points = replace(
        points,
        u=u[fine],
        v=v[fine],
        points_m=mean @ points.points_m,
        shared_m=np.einsum("gn,kni->kgi", mean, points.shared_m),
        own_m2=np.einsum("gn,nij->gij", mean**2, points.own_m2),
    )
    doubts: tuple[Doubt, ...] = ()
    if not fine.all():
        missing = [name for name, is_whole in zip(names, whole, strict=True) if not is_whole]
        text = f"{len(missing)} of {len(names)} targets of {section.file} are not used: {', '.join(missing[:8])}"
        doubts = (Doubt("display_targets_missing", text, {"targets_count": len(missing)}),)
    origin = f"{int(fine.sum())} targets with known fractions"
    gathered = (*seen.doubts, *result.doubts, *doubts)
    own_frame = measurement.model.shape.frame == "screen"
    return ScreenNetwork(result, np.zeros((0, 2), dtype=np.intp), points, origin, gathered, own_frame)


def _corners(name: str) -> list[str]:
    return [f"{name}.{k}" for k in range(4)]


def read_display(file: Path) -> tuple[list[str], FloatArray, FloatArray]:
    """Return names and fractions u, v of coded targets.

    InputError: A table that cannot be read, or whose numbers are no fractions.
    """
    columns = read_table_csv(file, ("target", "u", "v"))
    try:
        u, v = (np.array([float(one) for one in columns[name]]) for name in ("u", "v"))
    except ValueError as error:
        raise InputError(f"{file}: u and v must be numbers ({error})") from None
    if u.size and (min(u.min(), v.min()) < -0.5 or max(u.max(), v.max()) > 1.5):
        raise InputError(
            f"{file}: u, v go from {min(u.min(), v.min()):g} to {max(u.max(), v.max()):g}; fractions of the displayed "
            "image are needed (0 to 1, u from its left edge, v from its top edge)"
        )
    return list(columns["target"]), u, v


def _screen_points(
    measurement: ScreenMeasurement, bundle: BundleResult, index: IntArray, u: FloatArray, v: FloatArray
) -> ScreenPoints:
    """Return some targets of the network with all that they share with each other and the measuring camera."""
    photos = bundle.problem.observations.photos
    measuring = measurement.model.measuring_photo
    if measuring is not None and measuring not in photos:
        raise EstimationError(
            f"measuring_photo = {measuring!r} is not in the network: it shows too few targets that others show too"
        )
    at = [] if measuring is None else [photos.index(measuring)]
    own_frame = measurement.model.shape.frame == "screen"
    errors = bundle.covariance.shared_errors(index, at, under_datum=not own_frame)
    steps = errors.photos[:, 0] if at else np.zeros((len(errors.targets), 6))
    return ScreenPoints(
        u=u,
        v=v,
        points_m=bundle.state.points_m[index],
        shared_m=errors.targets,
        own_m2=errors.own,
        cam_from_world=bundle.cam_from_world[at[0]] if at else None,
        pose_steps=steps,
        viewer_m=bundle.state.centers_m.mean(axis=0),
    )
