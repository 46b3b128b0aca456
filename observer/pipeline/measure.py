"""Photos of a trough to slope errors, absorber position and what they cost: the stages in a row."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from heliogauge.doubts import gather_doubts
from heliogauge.errors import showing
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import naming_all_unreadable, read_luma
from heliogauge.running.progress import Progress, SilentProgress
from observer.doubts.photos import refuse_impossible_cameras
from observer.keys import ObserverMeasurement
from observer.photo_edges.views import Shot
from observer.pipeline.cameras import Cameras, adjust_turning
from observer.pipeline.corners import find_corners
from observer.pipeline.inputs import Inputs, read_inputs
from observer.pipeline.intercept import evaluate_intercept
from observer.pipeline.judgement import judge, without_consequences
from observer.pipeline.mirror import SolvedMirror, asking_for_diameter, place_absorber, refine_poses, solve_mirror
from observer.pipeline.panels import place_panels
from observer.pipeline.reading.photos import FirstLook, SeenInPhotos, look_again, look_first
from observer.pipeline.result import Result
from observer.pipeline.stated_camera import blamed
from observer.pipeline.target_list import check_list, keep_placed
from observer.pipeline.unknown_camera import start_unknown_camera
from observer.product.panel_alignment import panel_tilts
from observer.product.pictures import Overlay, draw_overlay
from observer.selection.edge_refusal import EdgeFate
from observer.trough.absorber_path import AbsorberPath


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    Parameters
    ----------
    jobs : int or None
        Photos that are measured side by side; None for all processors.
    """

    jobs: int | None = None


def run(measurement: ObserverMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Evaluate a measurement.

    Parameters
    ----------
    measurement : ObserverMeasurement
        From `heliogauge.measurement.load`; of a single collector.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Told of each stage.

    Returns
    -------
    Result
        Slope errors, absorber and cameras with their uncertainty, and what is doubtful.

    Raises
    ------
    InputError
        Photos, targets or camera that cannot be used, or several modules.
    EstimationError
        The photos do not hang together, or too little of the reflection is seen.
    """
    options, progress = options or Options(), progress or SilentProgress()
    inputs = start_unknown_camera(read_inputs(measurement, progress), options.jobs, progress)
    files = inputs.survey.photo_files
    with naming_all_unreadable(files):
        if inputs.corners is None:
            first = look_first(files, inputs.finder, jobs=options.jobs, progress=progress)
        else:
            first = find_corners(files, inputs.finder, inputs.corners, jobs=options.jobs, progress=progress)
    return evaluate(inputs, first, options, progress)


def evaluate(inputs: Inputs, first: FirstLook, options: Options, progress: Progress) -> Result:
    """Solve for cameras, mirror and absorber from what was found in the photos.

    first: What was found when the photos were read.
    InputError: Photos that cannot be used.
    EstimationError: The photos do not hang together, or too little of the reflection is seen.
    """
    if inputs.corners is None:
        listed = check_list(inputs.survey, inputs.finder, inputs.targets_file, first)
    else:
        listed = keep_placed(inputs.survey, first)
    listed, cameras = adjust_turning(listed, inputs, options.jobs, progress)
    refuse_impossible_cameras(cameras.photos.eyes_m, inputs.finder.known.points_m, inputs.collector)
    seen = look_again(cameras.files, cameras.views, inputs.finder, listed.first, jobs=options.jobs, progress=progress)
    kept = listed.first.kept
    panels = place_panels(inputs, cameras, seen, options.jobs, progress, kept)
    kept.clear()
    cameras, seen = panels.cameras, panels.seen
    shown = partial(cameras.network.measured.pictures, "too little is seen of the absorber")
    blame = partial(blamed, cameras.network, listed.survey, listed.first)
    with progress.stage("absorber"), blame(), showing(shown), asking_for_diameter(inputs, cameras):
        placed = place_absorber(inputs, seen, cameras.photos)
    with progress.stage("slopes"), blame(), showing(shown):
        mirror = solve_mirror(inputs, seen, cameras.photos, placed)
    with progress.stage("intercept factor"), blame():
        tilts = panel_tilts(mirror.angles.theta_ra_rad, mirror.angles.to_tube, inputs.collector)
        intercept = evaluate_intercept(
            inputs.light, mirror.slope_map, mirror.absorber, inputs.collector, tilts, mirror.reflector.sums
        )
    with progress.stage("picture"):
        refined = refine_poses(cameras.photos, mirror.reflector)
        picture = _draw_clearest(inputs, cameras, refined.poses, seen, mirror)
    with progress.stage("check the design"):
        doubts = judge(inputs, listed, panels, placed, mirror, seen.encodings)
    return Result(
        inputs.collector,
        inputs.orientation_rad,
        cameras.network,
        seen,
        mirror.absorber,
        mirror.solution,
        mirror.reflector,
        mirror.slope_map,
        mirror.visible,
        mirror.angles,
        intercept,
        cameras.photos,
        refined.poses,
        refined.covariances,
        picture,
        cameras.motions,
        inputs.n_modules,
        name=inputs.name,
        doubts=without_consequences(
            gather_doubts(cameras.network.doubts, cameras.doubts, seen.encodings.doubts, doubts, intercept.doubts)
        ),
        durations_s=dict(progress.durations_s),
        input_sha256=inputs.input_sha256,
    )


def _draw_clearest(
    inputs: Inputs, cameras: Cameras, poses: tuple[RigidTransform, ...], seen: SeenInPhotos, mirror: SolvedMirror
) -> Overlay:
    """Predict the reflection in the photo that gave most edges.

    poses: As refined.
    """
    used = seen.edges.photo[mirror.reflector.fate == EdgeFate.USED]
    clearest = int(np.argmax(np.bincount(used)))
    view = cameras.views[clearest].posed(poses[clearest])
    shot = Shot(read_luma(cameras.files[clearest]), clearest, view)
    return draw_overlay(
        shot, mirror.slope_map, AbsorberPath.designed(inputs.collector), mirror.absorber, inputs.collector
    )
