"""Where the absorber is, then the mirror's slopes and the absorber together; poses as the reflection refines them."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.absorber.other_diameter import other_diameter_m
from observer.absorber.position import AbsorberSolution, solve_absorber
from observer.doubts.photos import sparse_doubt
from observer.photo_edges.views import Shot
from observer.pipeline.cameras import Cameras
from observer.pipeline.inputs import Inputs
from observer.pipeline.reading.photos import SeenInPhotos
from observer.product.slope_map import AngleMaps, angle_maps, known_theta_r, slope_map_of, slopes_to_tube
from observer.selection.solve_and_refuse import Reflector, solve_reflector
from observer.slopes.pose_modes import Photos
from observer.trough.absorber_path import AbsorberPath
from observer.trough.visibility import Visibility, visibility

#: Photos that are searched for a tube of another diameter, evenly over the flight.
_MOST_ASKED = 12


@dataclass(frozen=True, slots=True, eq=False)
class PlacedAbsorber:
    """Where the absorber is before the slopes are known.

    path: The axis: measured, of the table, or of the design.
    solution: Its measurement; None where it was given.
    seen: Where the photos show it although a table gives it; None where they do not, or no table does.
    """

    path: AbsorberPath
    solution: AbsorberSolution | None
    seen: AbsorberSolution | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SolvedMirror:
    """The mirror as measured, with the absorber.

    reflector: Slope errors of all rows.
    absorber: The tube's axis, adjusted together with them.
    solution: Its measurement; None where it was given.
    visible: What the cameras can see of the tube by way of each node.
    slope_map: The mirror in the common form.
    angles: The same as angles, with the absorber's share.
    """

    reflector: Reflector
    absorber: AbsorberPath
    solution: AbsorberSolution | None
    visible: Visibility
    slope_map: SlopeMap
    angles: AngleMaps


class RefinedPoses(NamedTuple):
    """Poses of the photos as targets and reflection together have them.

    poses: ``cam_from_frame`` of each.
    covariances (n, 6, 6): Of the steps of each [rad, m].
    """

    poses: tuple[RigidTransform, ...]
    covariances: FloatArray


def place_absorber(inputs: Inputs, seen: SeenInPhotos, photos: Photos) -> PlacedAbsorber:
    """Find the absorber where it is to be measured.

    EstimationError: The photos do not show it from two sides.
    """
    path, solution, shown = inputs.absorber, None, None
    if inputs.absorber_source == "photos":
        solution = solve_absorber(seen.bearings, photos, path, inputs.stations_m, inputs.collector)
        path = solution.path
    elif inputs.absorber_source == "file":
        with suppress(EstimationError):
            shown = solve_absorber(seen.bearings, photos, path, inputs.stations_m, inputs.collector)
    return PlacedAbsorber(path, solution, shown)


@contextmanager
def asking_for_diameter(inputs: Inputs, cameras: Cameras) -> Iterator[None]:
    """Say where an absorber is not found whether it would be with another diameter than stated.

    cameras: Photos with adjusted poses.
    Returns: While its place is measured.
    EstimationError: What was raised, or that the stated diameter is wrong.
    """
    try:
        yield
    except EstimationError as error:
        if inputs.absorber_source != "photos":
            raise
        every = -(-len(cameras.files) // _MOST_ASKED)
        numbered = list(enumerate(zip(cameras.files, cameras.views, strict=True)))[::every]
        shots = [Shot(inputs.finder.read(file), number, view) for number, (file, view) in numbered]
        seen = other_diameter_m(shots, inputs.finder.expected)
        if seen is None:
            raise
        stated = inputs.collector.absorber_diameter_m
        raise EstimationError(
            f"absorber: collector.absorber_diameter_mm = {1e3 * stated:g} mm does not fit: the tube is not found with "
            f"it, and in many rows with another one: it looks {1e3 * seen:.0f} mm thick, within some 3 mm; it is the "
            "diameter of the metal tube, without the glass"
        ) from error


def solve_mirror(inputs: Inputs, seen: SeenInPhotos, photos: Photos, placed: PlacedAbsorber) -> SolvedMirror:
    """Solve for the slopes of the mirror and make their map.

    EstimationError: Too little of the reflection is seen.
    """
    collector, solution = inputs.collector, placed.solution
    expected = replace(inputs.finder.expected, absorber=placed.path)
    together = photos if solution is None else replace(photos, with_tube=solution.with_poses)
    reflector = solve_reflector(
        seen.edges,
        together,
        expected,
        inputs.column_step_m,
        inputs.prior,
        shaped=inputs.shape_from_slopes,
        outward_rad=seen.encodings.outward_rad,
    )
    absorber = reflector.absorber
    nodes = (reflector.grid.x_m, reflector.y_m)
    visible = visibility(nodes, photos.eyes_m, collector, absorber, known_theta_r(reflector, collector))
    slope_map = slope_map_of(reflector, collector, visible)
    if not slope_map.valid.any():
        raise EstimationError(f"reflection: {sparse_doubt(0.0, photos.eyes_m)}")
    angles = angle_maps(slope_map, absorber, collector, slopes_to_tube(reflector, slope_map))
    adjusted = None if solution is None else replace(solution, path=absorber)
    return SolvedMirror(reflector, absorber, adjusted, visible, slope_map, angles)


def refine_poses(photos: Photos, reflector: Reflector) -> RefinedPoses:
    """Return the poses that the edges of the reflection have added to."""
    errors = reflector.errors
    return RefinedPoses(
        *reflector.unknowns.moved_poses(photos.poses, photos.covariance, errors.common, errors.covariance_common)
    )
