"""Panels and cameras by the panels' own edges in the photos, where the collector's drawing says where these are.

The targets have given the poses. A first solution for the slopes, from some rows and photos, says what shape the panels
have; then their edges say how high each is, and where all cameras are over the mirror.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError
from heliogauge.images.photos import Image
from heliogauge.running.progress import Progress
from heliogauge.running.threads import side_by_side
from heliogauge.validate import Float32Array, FloatArray, IntArray
from observer.corners.lattice import PanelLattice
from observer.corners.list_beside import ListBeside, list_steps
from observer.corners.panel_lines import Pieces, line_pieces, lines_in, photo_noise
from observer.corners.placed_panels import (
    EdgeEnds,
    PlacedByEdges,
    edge_sights,
    joined_sights,
    place_by_edges,
)
from observer.corners.stated_edges import StatedEdge, stated_edges, strange_edges
from observer.keys import CornersSection
from observer.photo_edges.moved_edges import bearings_in_poses, edges_in_poses
from observer.pipeline.cameras import Cameras
from observer.pipeline.inputs import Inputs
from observer.pipeline.mirror import place_absorber, solve_mirror
from observer.pipeline.reading.photos import SeenInPhotos, evenly
from observer.selection.solve_and_refuse import Reflector
from observer.slopes.pose_modes import Photos

#: Rows of the first solution: enough, with the photos that are looked at for edges, for the shape of panels.
_MOST_ROWS = 60
#: Photos in which each stated edge is looked for in both directions: four show where it is to a millimetre.
_CHECKED_PHOTOS = 8
#: How far beside its prediction an edge is looked for: poses are good to a millimetre, panels to a few [px].
_REACH_PX = 6.0
#: With less than this share of the edges in the photos found where they should be the drawing is not believed.
_LEAST_SHARE = 0.5
#: An edge beside the drawing by so many standard deviations is named: by chance one in 10^4.
_BESIDE = 4.0
#: Fewest rows that tell how a panel's edge runs.
_FEWEST_ROWS = 3


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPanels:
    """Cameras and what was seen, with the poses that targets and panels' edges say together.

    doubts: Of the drawing.
    listed: How the list of targets stands beside the mirror; None where the edges do not say it.
    moved_rad: By how much slopes are others, RMS, with the list put right where the edges contradict it; NaN where too
        little of the reflection is seen to compare them [rad].
    """

    cameras: Cameras
    seen: SeenInPhotos
    doubts: tuple[Doubt, ...] = ()
    listed: ListBeside | None = None
    moved_rad: float = 0.0


def place_panels(
    inputs: Inputs,
    cameras: Cameras,
    seen: SeenInPhotos,
    jobs: int | None,
    progress: Progress,
    at_hand: Mapping[str, Image] = MappingProxyType({}),
) -> PlacedPanels:
    """Refine poses, and find out how high the panels are, by the edges of the panels; ask them for the list of targets.

    jobs: Photos side by side.
    at_hand: Photos that need not be read again, as their files store them.
    Returns: All as it was where edges were used as targets already, cameras move while they read a frame, the drawing
        has no gaps, or too little is seen. Where the edges contradict the list the doubts of the drawing are those with
        the list put right.
    InputError: A photo cannot be read.
    """
    by_edges = partial(_placed, jobs=jobs, progress=progress, at_hand=at_hand)
    placed = by_edges(inputs, cameras, seen)
    wrong = np.zeros(3) if placed.listed is None else placed.listed.contradicting(inputs.n_modules)
    if not wrong.any():
        return placed
    steps = list_steps(cameras.photos.poses, inputs.collector.rim_height_m) @ wrong
    poses = tuple(pose.moved(step) for pose, step in zip(cameras.photos.poses, steps, strict=True))
    moved, seen_there = _in_poses(inputs, cameras, seen, replace(cameras.photos, poses=poses))
    mended = by_edges(inputs, moved, seen_there)
    if mended.listed is not None:
        # Once more from where all is linear, with the shape of panels that comes out there.
        placed = replace(placed, listed=mended.listed.since(wrong))
    return replace(placed, doubts=mended.doubts, moved_rad=_moved_rad(inputs, placed, mended))


def _moved_rad(inputs: Inputs, *placed: PlacedPanels) -> float:
    """Return by how much slopes of some rows from some photos differ, RMS; NaN where none are measured in both."""
    chosen = evenly(len(placed[0].cameras.files))
    try:
        one, other = (_first_solution(inputs, each.cameras.photos, each.seen, chosen) for each in placed)
    except EstimationError:
        # What is missing is said where all photos are used.
        return np.nan
    apart = (one.errors.slopes - other.errors.slopes)[one.measured & other.measured, 0]
    return float(np.sqrt(np.mean(apart**2))) if apart.size else np.nan


def _placed(
    inputs: Inputs,
    cameras: Cameras,
    seen: SeenInPhotos,
    *,
    jobs: int | None,
    progress: Progress,
    at_hand: Mapping[str, Image],
) -> PlacedPanels:
    """Do as `place_panels` does with the list as it is."""
    unchanged = PlacedPanels(cameras, seen)
    collector = inputs.collector
    if inputs.corners is not None or cameras.photos.moving or collector.panel_gap_m == 0 or collector.n_panels < 2:
        return unchanged
    usual = CornersSection()
    lattice = PanelLattice(collector, 1e-3 * usual.mounting_sigma_mm, 1e-3 * usual.corner_sigma_mm)
    chosen = evenly(len(cameras.files))
    ends, shape = EdgeEnds.of(lattice), np.zeros(2 * len(lattice.along_trough))
    # A real mirror has the shape of its slopes unless somebody says otherwise; what does not fit makes sigma larger.
    if inputs.shape_from_slopes is not False:
        with progress.stage("shape of panels"):
            try:
                shape = _shape_of(_first_solution(inputs, cameras.photos, seen, chosen), ends, inputs)
            except EstimationError:
                # What is missing is said where all photos are used.
                return unchanged
    reader = replace(inputs.finder, encodings=seen.encodings)
    with progress.stage("edges of panels", chosen.size) as stage:

        def image_of(number: int) -> Float32Array:
            file = cameras.files[number]
            stored = at_hand.get(file.name)
            light = reader.read(file) if stored is None else reader.as_light(stored, file.name)
            return np.asarray(light, dtype=np.float32)

        def one(number: int) -> tuple[Pieces, float]:
            image = image_of(number)
            pieces = line_pieces(image, cameras.views[number], lattice, lattice.along_trough, _REACH_PX)
            stage.advance()
            return pieces, photo_noise(image)

        pieces, noise = zip(*side_by_side(one, chosen.tolist(), jobs), strict=True)
        looked = lines_in(pieces, lattice.along_trough, noise)
        some = chosen[np.unique(np.linspace(0, chosen.size - 1, _CHECKED_PHOTOS).round().astype(np.intp))].tolist()
        stated = stated_edges(lambda k: image_of(some[k]), [cameras.views[number] for number in some], lattice)
    strange = strange_edges(stated)
    doubts = tuple(stated_doubts(stated, lattice))
    # What is found near the place of an edge that is elsewhere is another thing.
    wrong = {one.number for one in strange if one.axis == 0}
    kept = np.array([line.number not in wrong for line in lattice.along_trough])
    lines = [tuple(one if right else None for one, right in zip(found, kept, strict=True)) for found, _ in looked]
    shown = sum(int(np.count_nonzero(pieces[kept])) for _, pieces in looked)
    # Where all joints are aside the lines that are left, of rims, hardly say how the list stands.
    aside = all_aside(stated, lattice)
    unchanged = replace(unchanged, doubts=doubts, listed=aside)
    if shown == 0:
        return unchanged
    share = sum(line is not None for found in lines for line in found) / shown
    if share < _LEAST_SHARE:
        text = (
            f"collector: only {100 * share:.0f} % of the panels' edges that the photos should show are where "
            "panel_edges_x_m and panel_edges_y_m have them; they were not used for the heights of panels and the frame "
            "of the targets"
        )
        unseen = Doubt("panel_edges_not_seen", text, {"seen_ratio": share}, Severity.NOTE)
        return replace(unchanged, doubts=(*doubts, unseen))
    sights = joined_sights(
        [edge_sights(int(k), cameras.views[k], lattice, found) for k, found in zip(chosen, lines, strict=True)]
    )
    placed = place_by_edges(sights, ends, shape, cameras.photos, lattice, inputs.prior.along_rad)
    cameras, seen = _in_poses(inputs, cameras, seen, placed.photos)
    doubts = gather_doubts(doubts, _beside_doubt(placed, ends, lattice))
    return PlacedPanels(cameras, seen, doubts, placed.listed if aside is None else aside)


def _in_poses(inputs: Inputs, cameras: Cameras, seen: SeenInPhotos, photos: Photos) -> tuple[Cameras, SeenInPhotos]:
    """Return cameras and what was seen with other poses."""
    views = tuple(view.posed(pose) for view, pose in zip(cameras.views, photos.poses, strict=True))
    expected = inputs.finder.expected
    moved = replace(
        seen,
        edges=edges_in_poses(seen.edges, cameras.views, views, expected),
        bearings=bearings_in_poses(seen.bearings, cameras.views, views, expected),
    )
    return replace(cameras, photos=photos, views=views), moved


def all_aside(edges: Sequence[StatedEdge], lattice: PanelLattice) -> ListBeside | None:
    """Return how far the list is aside where photos show all joints across the trough to one side of the drawing."""
    seen = [one for one in edges if one.axis == 0 and one.is_seen]
    aside = float(np.median([one.beside_m for one in seen])) if seen else 0.0
    # A rim that is elsewhere leaves open which of both is wrong.
    if not _to_one_side(seen) or any(one.is_rim and abs(one.beside_m - aside) > one.limit_m for one in seen):
        return None
    # Panels that are mounted each for itself.
    sigma = float(np.hypot(lattice.mounting_sigma_m, lattice.corner_sigma_m)) / len(seen) ** 0.5
    return ListBeside(np.array([aside, 0.0, 0.0]), np.array([sigma, np.inf, np.inf]))


def _to_one_side(seen: Sequence[StatedEdge]) -> bool:
    """Return whether all joints that are seen are to one side of the drawing, by the same."""
    joints = [one for one in seen if not one.is_rim]
    if len(joints) < 2 or not all(one.is_beside for one in joints) or len({one.beside_m > 0 for one in joints}) > 1:
        return False
    aside = float(np.median([one.beside_m for one in joints]))
    return all(abs(one.beside_m - aside) < one.limit_m for one in joints)


def _first_solution(inputs: Inputs, photos: Photos, seen: SeenInPhotos, chosen: IntArray) -> Reflector:
    """Solve for the slopes of some rows from some photos.

    EstimationError: Too little of the reflection is seen.
    """
    expected = inputs.finder.expected
    placed = place_absorber(inputs, seen, photos)
    rows = np.unique(np.linspace(0, expected.y_m.size - 1, min(expected.y_m.size, _MOST_ROWS)).round().astype(np.intp))
    some = np.isin(seen.edges.photo, chosen) & np.isin(seen.edges.row, rows)
    edges = seen.edges.chosen(some)
    fewer = replace(edges, photo=np.searchsorted(chosen, edges.photo), row=np.searchsorted(rows, edges.row))
    steps = (6 * chosen[:, None] + np.arange(6)).ravel()
    panels = photos.panels
    if panels is not None:
        panels = replace(panels, with_poses=panels.with_poses[:, steps], by_poses=panels.by_poses[:, steps])
    own = Photos(tuple(photos.poses[k] for k in chosen), photos.covariance[np.ix_(steps, steps)], panels=panels)
    finder = replace(inputs.finder, expected=replace(expected, y_m=expected.y_m[rows]))
    solution = placed.solution
    if solution is not None and solution.with_poses is not None:
        placed = replace(placed, solution=replace(solution, with_poses=solution.with_poses[:, steps]))
    # The shape that the slopes say, whether the mirror has it or not.
    shaped = replace(inputs, finder=finder, shape_from_slopes=True)
    return solve_mirror(shaped, replace(seen, edges=fewer), own, placed).reflector


def _shape_of(reflector: Reflector, ends: EdgeEnds, inputs: Inputs) -> FloatArray:
    """Return how high the panels' edges are by the shape of the panels, the mean of both sides, shape (e,) [m]."""
    collector, grid, found = inputs.collector, reflector.grid, np.zeros(ends.panel.shape)
    pieces = np.cumsum(np.concatenate([[0], ~grid.joined]))
    for k, side in zip(*np.nonzero(ends.panel >= 0), strict=True):
        row, column = divmod(int(ends.panel[k, side]), len(collector.panel_edges_x_m) - 1)
        first, last = collector.panel_edges_y_m[row : row + 2]
        nodes = np.flatnonzero(pieces == column)
        inside = (reflector.y_m > first) & (reflector.y_m < last)
        rows = np.flatnonzero(inside & reflector.measured[:, nodes].any(axis=1))
        if rows.size < _FEWEST_ROWS or nodes.size < 2:
            continue
        # A panel's edge lies half a step beyond its last node.
        near, before = nodes[[-1, -2]] if side == 0 else nodes[[0, 1]]
        edge = collector.panel_edges_x_m[column + 1 - side]
        share = (edge - grid.x_m[before]) / (grid.x_m[near] - grid.x_m[before])
        height = (1 - share) * reflector.height_m[rows, before] + share * reflector.height_m[rows, near]
        found[k, side] = np.polynomial.polynomial.polyfit(reflector.y_m[rows] - ends.points_m[k, 1], height, 1)[0]
    return np.asarray(found.sum(axis=1) / ends.sides)


def stated_doubts(edges: Sequence[StatedEdge], lattice: PanelLattice) -> Iterator[Doubt]:
    """Yield a doubt for each key whose entries the photos show elsewhere, or do not show."""
    strange = strange_edges(edges)
    for axis, name in enumerate("xy"):
        seen = [one for one in edges if one.axis == axis and one.is_seen]
        joints = [one for one in strange if one.axis == axis and not one.is_rim]
        rims = [one for one in strange if one.axis == axis and one.is_rim]
        key, stated_m = f"collector.panel_edges_{name}_m", lattice.edges_m[axis]
        if joints:
            text = (
                f"{key}: in the photos {_places(joints, stated_m)}; mend these, until then slopes beside them are "
                "wrong by far more than their sigma"
            )
            severity = Severity.DOUBT
            if _to_one_side(seen):
                text += (
                    f"; all that are seen, to the same side by the same: if they are right, {name}_m of all targets in "
                    "the list is not, and what counts from there; are these given from the vertex in the middle of "
                    "the length?"
                )
                # Across the trough all slopes are wrong with either, not those beside the joints alone.
                severity = Severity.SERIOUS if axis == 0 else severity
            largest = max((abs(one.beside_m) for one in joints if one.is_seen), default=0.0)
            yield Doubt(
                "stated_panel_edges_wrong", text, {"entries_count": len(joints), "largest_m": largest}, severity
            )
        if rims:
            text = (
                f"{key}: in the photos what looks like the rim of the mirror, {_places(rims, stated_m)}; is that the "
                "rim, or a frame around it?"
            )
            largest = max(abs(one.beside_m) for one in rims)
            yield Doubt("stated_rims_beside", text, {"entries_count": len(rims), "largest_m": largest}, Severity.NOTE)


def _places(edges: Sequence[StatedEdge], stated_m: FloatArray) -> str:
    """Say where entries are in photos."""
    return ", ".join(
        f"entry {one.number + 1} ({stated_m[one.number]:g} m) "
        + (f"is at {round(stated_m[one.number] + one.beside_m, 3) + 0.0:.3f} m" if one.is_seen else "is not seen")
        for one in edges
    )


def _beside_doubt(placed: PlacedByEdges, ends: EdgeEnds, lattice: PanelLattice) -> Doubt | None:
    """Name the edge that is farthest beside the drawing."""
    worst = int(np.argmax(placed.over_sigma))
    if placed.over_sigma[worst] < _BESIDE:
        return None
    line = lattice.along_trough[worst // 2]
    off = float(placed.ends_m[worst, 0])
    x, y = ends.points_m[worst, :2].tolist()
    text = (
        f"collector.panel_edges_x_m: the edge at x = {x:.3f} m, y = {y:.2f} m lies {1e3 * off:+.1f} mm beside it in "
        f"the photos, {placed.over_sigma[worst]:.1f} times what panels are usually off; is entry {line.number + 1} "
        "right?"
    )
    numbers = {"beside_m": off, "over_sigma_ratio": float(placed.over_sigma[worst])}
    return Doubt("panel_edge_beside_drawing", text, numbers)
