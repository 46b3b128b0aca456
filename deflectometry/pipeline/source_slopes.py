"""From a source whose mirror is located to its smooth shape and the slopes of its samples."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from deflectometry.pose.find_pose import LocatedMirror
from deflectometry.pose.mirror_outline import mirror_masks
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.facet_pixels import UsableFacets, solve_shape_of_pixels, usable_facets
from deflectometry.shape.pixel_slopes import SlopeImage, measure_slopes
from deflectometry.shape.smooth_shape import ShapeSolution
from deflectometry.sources.display_edge import DisplayEdge
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Source
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.running.progress import Progress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FlagArray


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPixels(ShortRepr):
    """Which facet each pixel of the image sees.

    facet_index (h, w): Facet of each pixel, -1 beside them.
    flags (h, w): Why a pixel sees none.
    """

    facet_index: npt.NDArray[np.int16]
    flags: FlagArray

    @classmethod
    def of(cls, source: Source, setup: Setup, located: LocatedMirror) -> "MirrorPixels":
        """Return those of a located mirror; pixels that mix it with what is beside it are left out."""
        margin_px = located.margin_px if source.mixes_edges else 0.0
        masks = mirror_masks(setup.camera, located.outline_pose, located.facets, margin_px=margin_px)
        return cls(masks.facet_index, masks.flags)


@dataclass(frozen=True, slots=True, eq=False)
class SolvedSource(ShortRepr):
    """The smooth shape that a source gives.

    screen_map: Point of the screen that each sample sees.
    facet_index (h, w): Facet of each sample, -1 elsewhere.
    edge: At which edges of the screen the mirror looks past it.
    usable: The facets that were measured, with some of their pixels.
    solution: Aligned pose and smooth shapes of these facets.
    """

    screen_map: ScreenMap
    facet_index: npt.NDArray[np.int16]
    edge: DisplayEdge
    usable: UsableFacets
    solution: ShapeSolution


def solve_source(
    source: Source, setup: Setup, located: LocatedMirror, pixels: MirrorPixels, progress: Progress, *, align: bool
) -> SolvedSource:
    """Find the point of the screen that each sample sees, and the smooth shape and pose that carry them.

    align: Turn the mirror so that its mean normal is the design's.
    EstimationError: No facet shows the pattern.
    """
    with progress.stage("screen points"):
        screen_map = source.screen_map(pixels.facet_index >= 0)
        grid = screen_map.grid
        facet_index = grid.of_image(pixels.facet_index, -1)
        beside = grid.of_image(pixels.flags, np.uint32(SampleFlag.OUTSIDE_MIRROR))
        screen_map = replace(screen_map, flags=np.where(beside != 0, beside, screen_map.flags))
        edge = source.display_edge(screen_map, facet_index >= 0, located.margin_px)
        screen_map = edge.screen_map
    with progress.stage("slopes"):
        usable = usable_facets(located.facets, screen_map, facet_index)
        solution = solve_shape_of_pixels(setup, usable.samples, located.pose.cam_from_mirror, align=align)
    return SolvedSource(screen_map, facet_index, edge, usable, solution)


def poses_of_facets(usable: UsableFacets, solution: ShapeSolution) -> dict[str, RigidTransform]:
    """Return the pose of each measured facet, by name."""
    return {sample.facet.name: solution.cam_from_mirror @ sample.facet.ensemble_from_facet for sample in usable.samples}


def slopes_of_facets(
    setup: Setup,
    screen_map: ScreenMap,
    facet_index: npt.NDArray[np.int16],
    usable: UsableFacets,
    solution: ShapeSolution,
) -> dict[str, SlopeImage]:
    """Return the slopes of all samples of each measured facet, by name."""
    poses = poses_of_facets(usable, solution)
    return {
        name: measure_slopes(setup, screen_map, facet_index == index, poses[name], surface)
        for name, index, surface in zip(poses, usable.numbers, solution.surfaces, strict=True)
    }
