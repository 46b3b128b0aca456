"""Targets without a code join a solved network: matched, named, adjusted with everything else, matched again."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.bundle.constraints import ControlPoint
from photogrammetry.bundle.state import BundleState
from photogrammetry.image_points import ImagePoints
from photogrammetry.matching.uncertain_rays import Dots, known_views
from photogrammetry.matching.uncoded_matching import MatchedDots, match_dots
from photogrammetry.matching.uncoded_names import ListedTargets, list_frame, name_points
from photogrammetry.networks.solve_network import Knowledge, NetworkCameras, Solved, SolveOptions, solve_from
from photogrammetry.start_values.network import ImagePlace, LeftOut, Network

#: Matching, adjusting and matching again changes nothing after two rounds where poses were good to begin with.
_ROUNDS = 3
#: Outer radius of a code ring, in radii of its dot, and a tenth more.
_RING_RADII = 3.3


@dataclass(frozen=True, slots=True, eq=False)
class LooseDots:
    """Dots without a code in photos, and what is known of them.

    photos: Names of the photos.
    dots: The dots; their places are those of ``photos``.
    listed: Approximate coordinates of some, whose names they get.
    """

    photos: tuple[str, ...]
    dots: Dots
    listed: ListedTargets | None = None

    def with_sigmas_times(self, factor: float) -> "LooseDots":
        """Return the dots with other sigmas."""
        return replace(self, dots=replace(self.dots, covariance_px2=factor**2 * self.dots.covariance_px2))


@dataclass(frozen=True, slots=True, eq=False)
class Extended:
    """A network with its dots.

    solved: The network, adjusted with all.
    points: All image points, matched dots at the end.
    ellipses_px2 (m, 2, 2): Their ellipses [px^2].
    names: Names of the points without a code.
    left: Listed targets and doubtful points that were not taken.
    doubts: What makes the naming doubtful.
    """

    solved: Solved
    points: ImagePoints
    ellipses_px2: FloatArray
    names: tuple[str, ...]
    left: tuple[LeftOut, ...]
    doubts: tuple[Doubt, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """One round of matching: points, names, the dots (of all) that are theirs."""

    matched: MatchedDots
    names: tuple[str, ...]
    rows: IntArray
    left: tuple[LeftOut, ...]
    doubts: tuple[Doubt, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Named:
    """Names of points, or None; listed targets without a point; what is doubtful."""

    names: tuple[str | None, ...]
    left: tuple[LeftOut, ...] = ()
    doubts: tuple[Doubt, ...] = ()


def add_dots(
    first: Solved,
    points: ImagePoints,
    ellipses_px2: FloatArray,
    loose: LooseDots,
    cameras: NetworkCameras,
    knowledge: Knowledge,
    options: SolveOptions,
) -> Extended:
    """Match dots without a code through a solved network and adjust them with it.

    first: The network of the coded targets.
    points: All image points of coded targets.
    ellipses_px2 (m, 2, 2): Their ellipses [px^2].
    cameras: What of the cameras is free, and whose the photos are.
    knowledge: Scale bars, control points, constraints and datum.
    Returns: The network with its points "u1", "u2"... (in the order of photos and of the dots in them) or, of
        listed ones, their names.
    EstimationError: The network with its points is not determined; it is named.
    """
    solved, before, now = first, None, None
    for _ in range(_ROUNDS):
        now = _match_and_name(solved, loose, knowledge, _coded_radii(solved.bundle, points, ellipses_px2))
        if before is not None and np.array_equal(before.matched.point_of_dot, now.matched.point_of_dot):
            break
        if not now.names:
            return Extended(first, points, ellipses_px2, (), now.left, now.doubts)
        table, shapes = _with_dots(points, ellipses_px2, loose, now)
        network = _start_network(solved, first, table, now)
        solved = solve_from(network, table, shapes, NetworkCameras.of(first.bundle), knowledge, options)
        solved = _with_earlier(solved, first)
        before = now
    last = before or now
    if last is None:
        return Extended(first, points, ellipses_px2, (), ())
    table, shapes = _with_dots(points, ellipses_px2, loose, last)
    return Extended(solved, table, shapes, last.names, last.left, last.doubts)


def _match_and_name(solved: Solved, loose: LooseDots, knowledge: Knowledge, coded: dict[str, float]) -> _Round:
    """Match the dots of the photos in the network, and name their points."""
    bundle = solved.bundle
    photos = bundle.problem.observations.photos
    place = {name: i for i, name in enumerate(photos)}
    index = np.array([place.get(name, -1) for name in loose.photos], dtype=np.intp)[loose.dots.photo_index]
    rows = np.nonzero(index >= 0)[0]
    # Dots are measured as the coded targets are: what their residuals say of the sigmas holds for both.
    scale = solved.image_sigma_factor**2
    dots = Dots(
        index[rows], loose.dots.pixels_px[rows], scale * loose.dots.covariance_px2[rows], loose.dots.ellipses_px2[rows]
    )
    raw = match_dots(dots, known_views(bundle))
    single, split = _without_split(raw, dots, bundle)
    found, unread = _without_coded(single, bundle, coded)
    named = _name_by_list(found, bundle, loose.listed, knowledge, set(coded))
    names = named.names
    numbers = (f"u{k}" for k in range(1, len(names) + len(coded) + 1) if f"u{k}" not in coded)
    final = tuple(name or next(numbers) for name in names)
    texts = [_with_photo(one, photos) for one in found.rejected]
    return _Round(found, final, rows, (*named.left, *split, *unread, *texts), named.doubts)


def _coded_radii(bundle: BundleResult, points: ImagePoints, ellipses_px2: FloatArray) -> dict[str, float]:
    """Return the radius of each coded target's dot [m]; 0 for corners and for targets outside the network."""
    table = bundle.problem.observations
    photo_place = {name: i for i, name in enumerate(table.photos)}
    place = {name: i for i, name in enumerate(table.targets)}
    radii: dict[str, list[float]] = {name: [] for name in points.targets}
    largest = np.sqrt(np.maximum(np.linalg.eigvalsh(np.nan_to_num(ellipses_px2))[:, 1], 0.0))
    for row in np.nonzero(largest > 0)[0].tolist():
        photo, name = photo_place.get(points.photos[points.photo_index[row]]), points.targets[points.target_index[row]]
        if photo is None or name not in place:
            continue
        depth = float(bundle.state.cam_from_world(photo).apply(bundle.state.points_m[place[name]])[2])
        focal = bundle.state.cameras[bundle.problem.camera_index[photo]].focal_x_px
        radii[name].append(float(largest[row]) * depth / focal)
    return {name: float(np.median(own)) if own else 0.0 for name, own in radii.items()}


def _without_coded(
    found: MatchedDots, bundle: BundleResult, coded: dict[str, float]
) -> tuple[MatchedDots, tuple[LeftOut, ...]]:
    """Leave out points within the ring of a coded target: its dot or its ring where the code was not read."""
    table = bundle.problem.observations
    own = np.array([i for i, name in enumerate(table.targets) if name in coded], dtype=np.intp)
    radii = np.array([coded[table.targets[i]] for i in own])
    far = np.linalg.norm(found.points_m[:, None] - bundle.state.points_m[own][None], axis=2)
    inside = far < _RING_RADII * radii
    gone = inside.any(axis=1)
    texts = tuple(
        LeftOut(f"target {table.targets[own[int(np.argmax(inside[k]))]]}", f"its code was not read in {count} photos")
        for k, count in zip(np.nonzero(gone)[0].tolist(), _rays(found)[gone].tolist(), strict=True)
    )
    return _without(found, gone), texts


def _without_split(found: MatchedDots, dots: Dots, bundle: BundleResult) -> tuple[MatchedDots, tuple[LeftOut, ...]]:
    """Leave out points closer to another than their dots are large: one dot, covered or glaring in some photos.

    Such images are displaced, in some photos alike, so that they agree with each other and with no other image of the
    dot. The point of clearly more rays stays; with no more than one ray more neither can be believed.
    """
    rays, radius = _rays(found), _dot_radii(found, dots, bundle)
    far = np.linalg.norm(found.points_m[:, None] - found.points_m[None], axis=2)
    close = far < np.minimum(radius[:, None], radius[None])
    np.fill_diagonal(close, False)
    weaker = close & (rays[:, None] <= rays[None] + 1)
    gone = weaker.any(axis=1)
    texts = []
    for k in np.nonzero(gone)[0].tolist():
        other = int(np.argmin(np.where(weaker[k], far[k], np.inf)))
        row = int(np.argmax(found.point_of_dot == k))
        x, y = dots.pixels_px[row]
        name = bundle.problem.observations.photos[int(dots.photo_index[row])]
        reason = (
            f"its images in {rays[k]} photos contradict those in {rays[other]} others by {1e3 * far[k, other]:.2g} mm, "
            "less than its size: partly covered or in glare"
        )
        texts.append(
            LeftOut(f"dot at ({x:.0f}, {y:.0f}) in photo {name}", reason, place=ImagePlace(name, float(x), float(y)))
        )
    return _without(found, gone), tuple(texts)


def _dot_radii(found: MatchedDots, dots: Dots, bundle: BundleResult) -> FloatArray:
    """Return the radius of the dot of each point: the smallest of its images' larger semi-axes, in space [m]."""
    state, camera = bundle.state, bundle.problem.camera_index
    radii = np.full(len(found.points_m), np.inf)
    for row in np.nonzero(found.point_of_dot >= 0)[0].tolist():
        point, photo = int(found.point_of_dot[row]), int(dots.photo_index[row])
        depth = float(state.cam_from_world(photo).apply(found.points_m[point])[2])
        axis = float(np.sqrt(max(float(np.linalg.eigvalsh(dots.ellipses_px2[row])[1]), 0.0)))
        radii[point] = min(float(radii[point]), axis * depth / state.cameras[camera[photo]].focal_x_px)
    return radii


def _without(found: MatchedDots, gone: BoolArray) -> MatchedDots:
    """Leave out points, their dots becoming free."""
    renumbered = np.append(np.where(gone, -1, np.cumsum(~gone) - 1), -1)
    return MatchedDots(
        found.points_m[~gone],
        found.covariance_m2[~gone],
        renumbered[found.point_of_dot],
        found.accidents[~gone],
        found.rejected,
    )


def _rays(found: MatchedDots) -> IntArray:
    matched = found.point_of_dot[found.point_of_dot >= 0]
    return np.bincount(matched, minlength=len(found.points_m))


def _with_photo(one: LeftOut, photos: tuple[str, ...]) -> LeftOut:
    """Put the name of a photo where its number stands."""
    if one.place is None:
        return one
    name = photos[int(one.place.photo)]
    head = one.name.removesuffix(one.place.photo)
    return replace(one, name=f"{head}{name}", place=replace(one.place, photo=name))


def _name_by_list(
    found: MatchedDots, bundle: BundleResult, listed: ListedTargets | None, knowledge: Knowledge, coded: set[str]
) -> _Named:
    """Name points by the list."""
    count = len(found.points_m)
    if listed is None or not len(listed):
        return _Named((None,) * count)
    places = {
        name: bundle.state.points_m[i] for i, name in enumerate(bundle.problem.observations.targets) if name in coded
    }
    own = [k for k, name in enumerate(listed.names) if name not in coded]
    wanted = ListedTargets(tuple(listed.names[k] for k in own), listed.points_m[own], listed.sigma_m[own])
    weighted = sum(isinstance(one, ControlPoint) for one in knowledge.constraints)
    try:
        settled = len(bundle.problem.fixed) >= 3 or weighted >= 3
        frame = RigidTransform.identity() if settled else list_frame(found.points_m, places, listed)
    except EstimationError as error:
        doubt = Doubt("uncoded_targets_unnamed", f"targets without a code keep their numbers: {error}")
        return _Named((None,) * count, doubts=(doubt,))
    named = name_points(found.points_m, found.covariance_m2, wanted, frame)
    return _Named(named.names, named.left)


def _with_dots(
    points: ImagePoints, ellipses_px2: FloatArray, loose: LooseDots, now: _Round
) -> tuple[ImagePoints, FloatArray]:
    """Append matched dots to the image points."""
    own = np.nonzero(now.matched.point_of_dot >= 0)[0]
    rows = now.rows[own]
    place = {name: i for i, name in enumerate(points.photos)}
    photo = [place[loose.photos[i]] for i in loose.dots.photo_index[rows]]
    covariance = loose.dots.covariance_px2[rows]
    table = ImagePoints(
        points.photos,
        (*points.targets, *now.names),
        np.concatenate([points.photo_index, np.array(photo, dtype=np.intp)]),
        np.concatenate([points.target_index, len(points.targets) + now.matched.point_of_dot[own]]),
        np.concatenate([points.pixels_px, loose.dots.pixels_px[rows]]),
        np.concatenate([points.covariance_px2, 0.5 * (covariance + np.swapaxes(covariance, 1, 2))]),
    )
    return table, np.concatenate([ellipses_px2, loose.dots.ellipses_px2[rows]])


def _start_network(solved: Solved, first: Solved, table: ImagePoints, now: _Round) -> Network:
    """Return start values: the adjusted network and the points of the dots."""
    old, state = solved.bundle.problem.observations, solved.bundle.state
    count = table.n - int(np.count_nonzero(now.matched.point_of_dot >= 0))
    base = np.zeros(table.n, dtype=np.bool_)
    base[first.network.rows] = True
    base &= np.isin(np.array(table.photos), old.photos)[table.photo_index]
    base &= np.isin(np.array(table.targets), old.targets)[table.target_index]
    base[count:] = True
    rows = np.nonzero(base)[0]
    kept = table.subset(rows).compacted()
    place = {name: i for i, name in enumerate(old.targets)}
    coded = state.points_m[[place[name] for name in kept.targets[: len(kept.targets) - len(now.names)]]]
    start = BundleState(
        state.cameras, state.rotations, state.translations_m, np.concatenate([coded, now.matched.points_m])
    )
    return replace(
        first.network,
        observations=kept,
        rows=rows,
        camera_of_photo=solved.bundle.problem.camera_index,
        state=start,
    )


def _with_earlier(solved: Solved, first: Solved) -> Solved:
    """Keep what the first adjustment rejected and this one did not see again."""
    again = {one.label for one in solved.rejected}
    table = solved.bundle.problem.observations
    present = {table.label(row) for row in range(table.n)}
    earlier = tuple(one for one in first.rejected if one.label not in again and one.label not in present)
    return replace(solved, rejected=(*earlier, *solved.rejected))
