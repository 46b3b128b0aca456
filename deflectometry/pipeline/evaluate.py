"""From images in memory to slope maps: the stages follow each other in `evaluate_source`."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from deflectometry.frames.image_file_checks import check_size
from deflectometry.pipeline.choices import Choices
from deflectometry.pipeline.source_slopes import MirrorPixels, poses_of_facets, slopes_of_facets, solve_source
from deflectometry.pose.find_pose import LocatedMirror, MirrorInput, find_pose
from deflectometry.pose.mirrors_in_image import find_mirrors
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.cell_modes import with_cells
from deflectometry.shape.common_modes import common_modes, moved_facets, moved_inputs
from deflectometry.shape.facet_pixels import UsableFacets, thinned
from deflectometry.shape.fine_structure import fine_responses, fine_share, place_covariance, with_waviness_out_of_place
from deflectometry.shape.gridding import grid_slopes, plan_grid
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import Align, ShapeSolution
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Source
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError
from heliogauge.running.progress import Progress
from heliogauge.short_repr import ShortRepr
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray

#: Pixels for the common modes: with 400 the coefficients of degree 3 are known 30 times better than one pixel.
MODE_PIXELS = 400


def _at_display_edge(source: Source, error: EstimationError) -> EstimationError:
    """Return why no outline was found: the mirror's image may end where the display ends."""
    try:
        region = find_mirrors(source.mirror_image()).mask
        screen_map = source.screen_map(region)
        edge = source.display_edge(screen_map, screen_map.grid.of_image(region, False), 1.5)
    except EstimationError:
        return error
    return EstimationError(f"{edge.words}. ({error})") if edge.edges else error


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation(ShortRepr):
    """Everything a measurement gave.

    located: Pose before alignment and its evidence.
    screen_map: Point of the screen that each sample sees.
    facet_index (h, w): Facet of each sample, -1 elsewhere.
    solution: Aligned pose and smooth shapes of the facets that were measured.
    images: Pixels of each measured facet.
    maps: Slope map of each measured facet, with nothing taken out but by the alignment.
    fine_maps: The same as fine as the pixels, whatever grid was asked for. Their curl is judged: means over the cells
        of a coarse grid fold waviness back, so that their differences are no longer those of one surface.
    fine_responses: What one sigma of each input adds to the waviness of each, from
        `deflectometry.shape.fine_structure.fine_responses`.
    choices: How the slopes are reported.
    doubts: What makes pose, facets or maps doubtful.
    sigma_turn_rad: Standard deviation of the mirror's orientation from the reflection, where all display points share
        an error [rad].
    """

    located: LocatedMirror
    screen_map: ScreenMap
    facet_index: npt.NDArray[np.int16]
    solution: ShapeSolution
    images: dict[str, SlopeImage]
    maps: dict[str, SlopeMap]
    fine_maps: dict[str, SlopeMap]
    fine_responses: dict[str, FloatArray]
    choices: Choices
    doubts: tuple[Doubt, ...] = ()
    sigma_turn_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Reflection(ShortRepr):
    """What a measurement gives before its slopes are laid on a grid; the fields of `Evaluation` are as there.

    usable: The facets that show the pattern, and their pixels.
    past_display: What is doubtful of the display's edge.
    """

    located: LocatedMirror
    screen_map: ScreenMap
    facet_index: npt.NDArray[np.int16]
    solution: ShapeSolution
    usable: UsableFacets
    choices: Choices
    past_display: Doubt | None
    sigma_turn_rad: float


def evaluate_source(
    source: Source, setup: Setup, mirror: MirrorInput, choices: Choices, progress: Progress
) -> Evaluation:
    """Evaluate the images of one measurement.

    setup: Camera and screen.
    Returns: Slopes of pixels and maps.
    InputError: Images that do not fit camera or pattern.
    EstimationError: No mirror found, or none of its facets shows the pattern.
    """
    return map_slopes(solve_reflection(source, setup, mirror, choices, progress), setup, progress)


def solve_reflection(
    source: Source, setup: Setup, mirror: MirrorInput, choices: Choices, progress: Progress
) -> Reflection:
    """Find the mirror's pose and smooth shape: all that says whether reflection and outline agree.

    Parameters and errors are those of `evaluate_source`.
    """
    check_size(source.size_px, setup.camera, "images")
    with progress.stage("find mirror"):
        try:
            located = find_pose(source, setup, mirror)
        except EstimationError as error:
            raise _at_display_edge(source, error) from error
    return reflect(source, setup, mirror, located, choices, progress)


def reflect(
    source: Source,
    setup: Setup,
    mirror: MirrorInput,
    located: LocatedMirror,
    choices: Choices,
    progress: Progress,
) -> Reflection:
    """Find the smooth shape of a mirror that is located, as `solve_reflection` does.

    EstimationError: None of its facets shows the pattern.
    """
    with progress.stage("find mirror"):
        pixels = MirrorPixels.of(source, setup, located)
    found = solve_source(source, setup, located, pixels, progress, align=choices.align is Align.NORMAL)
    solution, count = found.solution, len(found.usable.samples)
    past = found.edge.doubt if mirror.known_pose is None else None
    # A screen point that is off by s turns the normal by half of s over the distance.
    square = setup.sigma_shift**2
    for one in setup.facet_shifts:
        # The mean of all facets turns by the share of those that do.
        square = square + (one.sigma * len(one.facets) / count) ** 2
    off_m = np.sqrt(square) * setup.size_m
    mirror_m = (setup.cam_from_screen.inverse() @ solution.cam_from_mirror).translation_m
    sigma_turn = 0.5 * float(np.linalg.norm(off_m) / np.linalg.norm(mirror_m))
    return Reflection(located, found.screen_map, found.facet_index, solution, found.usable, choices, past, sigma_turn)


def map_slopes(reflection: Reflection, setup: Setup, progress: Progress) -> Evaluation:
    """Measure the slopes of all pixels with their uncertainty, and lay them on a grid."""
    located, screen_map, facet_index = reflection.located, reflection.screen_map, reflection.facet_index
    solution, usable, choices = reflection.solution, reflection.usable, reflection.choices
    samples, align = usable.samples, choices.align is Align.NORMAL
    with progress.stage("slopes"):
        surfaces = {sample.facet.name: surface for sample, surface in zip(samples, solution.surfaces, strict=True)}
        poses = poses_of_facets(usable, solution)
        images = slopes_of_facets(setup, screen_map, facet_index, usable, solution)
    with progress.stage("uncertainty"):
        few = [thinned(sample, max(MODE_PIXELS // len(samples), 60)) for sample in samples]
        modes = common_modes(setup, few, solution, located.pose, align=align, places=located.places)
        if screen_map.cells.any():
            modes = [
                with_cells(one, setup, screen_map, facet_index == number, poses[name], surfaces[name], images[name])
                for one, number, name in zip(modes, usable.numbers, images, strict=True)
            ]
        # Pose and set-up are those of all facets: what follows them is found once.
        inputs = tuple(moved_inputs(setup, solution.cam_from_mirror, located.pose))
        responses = {
            one.facet.name: fine_responses(setup, one, solution, inputs, surfaces[one.facet.name]) for one in few
        }
        fine = {name: fine_share(one, images[name], located.edge_width_px) for name, one in responses.items()}
        moved = (*inputs, *moved_facets(setup, solution.cam_from_mirror, located.pose, located.places))
        for one in few:
            name = one.facet.name
            place = place_covariance(setup, one, solution, moved, surfaces[name])
            images[name] = with_waviness_out_of_place(images[name], surfaces[name], place)
    plan = plan_grid(images, located.facets, choices.grid_step_m, choices.align)
    finest = plan_grid(images, located.facets, 0.0, choices.align)
    plans = (plan, finest) if plan.step_m > finest.step_m else (plan,)
    with progress.stage("maps", steps=len(images)) as stage:
        gridded, as_pixels = {}, {}
        for sample, common in zip(samples, modes, strict=True):
            name = sample.facet.name
            found = [
                grid_slopes(
                    images[name], surfaces[name], setup.camera, poses[name], sample.facet, plan=one, common=common
                )
                for one in plans
            ]
            gridded[name], as_pixels[name] = found[0], found[-1].slope_map
            stage.advance()
    doubts = gather_doubts(
        reflection.past_display, located.doubts, usable.doubts, *(one.doubts for one in gridded.values())
    )
    maps = {name: replace(one.slope_map, fine_share=fine[name]) for name, one in gridded.items()}
    fine_maps = {name: replace(one, fine_share=fine[name]) for name, one in as_pixels.items()}
    return Evaluation(
        located,
        screen_map,
        facet_index,
        solution,
        images,
        maps,
        fine_maps,
        responses,
        choices,
        doubts,
        reflection.sigma_turn_rad,
    )
