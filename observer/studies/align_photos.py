"""A few photos of a module to a prescription: how far each mount of each panel is to be moved (TOPCAT)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError
from heliogauge.images.photos import read_luma
from heliogauge.results.folder import PhotoPose
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.validate import FloatArray
from heliogauge.view.stills import Sheet
from observer.absorber.product import absorber_doubts
from observer.doubts.photos import refuse_impossible_cameras
from observer.keys import ObserverMeasurement
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.pipeline.cameras import Cameras, adjust_turning
from observer.pipeline.corners import find_corners
from observer.pipeline.inputs import read_inputs
from observer.pipeline.mirror import place_absorber
from observer.pipeline.reading.photos import look_again, look_first
from observer.pipeline.target_list import check_list, keep_placed
from observer.product.panel_alignment import PanelTilts, image_edges
from observer.product.tilts_from_photos import SeenPanels, tilts_from_photos
from observer.report.figures_alignment import theory_sheet
from observer.studies.align import Result, assumed_mounts, mount_places
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Rows at which the theoretical image is drawn in each panel.
_ROWS = 9


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    jobs: Photos that are measured side by side; None for all processors.
    """

    jobs: int | None = None


def run_on_photos(
    measurement: ObserverMeasurement,
    mounts: Path | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Result:
    """Prescribe how the panels of a module are to be aligned, from a few photos of it.

    mounts: Table with the columns x_m, y_m of all mounts; without it four mounts are assumed near the corners of
        each panel.
    Returns: Mean angles of the panels, what the mounts need, and the theoretical image over each photo.
    InputError: Photos, targets or camera that cannot be used.
    EstimationError: The photos do not hang together, or in no panel both edges of the image are seen.
    """
    options, progress = options or Options(), progress or SilentProgress()
    inputs = read_inputs(measurement, progress)
    files = inputs.survey.photo_files
    if inputs.corners is None:
        first = look_first(files, inputs.finder, jobs=options.jobs, progress=progress)
        listed = check_list(inputs.survey, inputs.finder, inputs.targets_file, first)
    else:
        first = find_corners(files, inputs.finder, inputs.corners, jobs=options.jobs, progress=progress)
        listed = keep_placed(inputs.survey, first)
    listed, cameras = adjust_turning(listed, inputs, options.jobs, progress)
    refuse_impossible_cameras(cameras.photos.eyes_m, inputs.finder.known.points_m, inputs.collector)
    seen = look_again(cameras.files, cameras.views, inputs.finder, listed.first, jobs=options.jobs, progress=progress)
    with progress.stage("absorber"):
        placed = place_absorber(inputs, seen, cameras.photos)
    collector = inputs.collector
    with progress.stage("panels"):
        found = tilts_from_photos(seen.edges, cameras.photos, collector, placed.path, inputs.finder.expected.y_m)
        if not np.isfinite(found.to_absorber.tilt_rad).any():
            raise EstimationError(
                f"reflection: in none of {found.to_absorber.tilt_rad.size} panels both edges of the absorber's image "
                "are seen; photograph each row of panels from before its middle, so that the image lies within it"
            )
    with progress.stage("pictures"):
        pictures = _pictures(cameras, seen.edges, found, placed.path, collector)
    doubts = gather_doubts(
        inputs.doubts,
        listed.doubts,
        cameras.network.doubts,
        cameras.doubts,
        seen.encodings.doubts,
        absorber_doubts(placed.path, placed.solution, inputs.collector, is_design=inputs.absorber_source == "design"),
        _panel_doubts(found.to_absorber),
        assumed_mounts() if mounts is None else None,
    )
    return Result(
        collector,
        _enough(found.to_absorber),
        _enough(found.to_design),
        mount_places(collector, mounts),
        placed.path,
        _cameras(cameras),
        pictures=pictures,
        name=inputs.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=dict(inputs.input_sha256),
    )


def _enough(tilts: PanelTilts) -> PanelTilts:
    """Return the turns of the panels whose image is seen in enough rows."""
    short = tilts.measured_share < LEAST_SHARE
    tilt, sigma = (np.where(short, np.nan, values) for values in (tilts.tilt_rad, tilts.sigma_rad))
    return PanelTilts(tilts.centre_x_m, tilts.centre_y_m, tilt, sigma, tilts.measured_share)


def _panel_doubts(tilts: PanelTilts) -> Iterator[Doubt]:
    missing = np.flatnonzero(np.isnan(tilts.tilt_rad) | (tilts.measured_share < LEAST_SHARE))
    if missing.size:
        some = ", ".join(str(number + 1) for number in missing[:8].tolist()) + (" ..." if missing.size > 8 else "")
        yield Doubt(
            "panels_without_image",
            f"{missing.size} of {tilts.tilt_rad.size} panels have no prescription, as both edges of the absorber's "
            f"image are in less than {100 * LEAST_SHARE:.0f} % of their rows: {some}; is a camera before their row, "
            "and the image within the panel?",
            {"unknown_count": missing.size, "panels_count": tilts.tilt_rad.size},
        )


def _cameras(cameras: Cameras) -> dict[str, tuple[Camera, PhotoPose]]:
    found = {}
    for k, (file, view) in enumerate(zip(cameras.files, cameras.views, strict=True)):
        block = cameras.photos.covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        found[file.name] = (view.camera, PhotoPose("camera", view.cam_from_frame, 0.5 * (block + block.T)))
    return found


def _pictures(
    cameras: Cameras, edges: ReflectionEdges, found: SeenPanels, absorber: AbsorberPath, collector: Collector
) -> dict[str, Sheet]:
    """Lay the theoretical image over each photo, beside the edges that were found."""
    panel = collector.panel_index(edges.points_m[:, 0], edges.points_m[:, 1])
    gap = collector.panel_gap_m / 2
    sheets = {}
    for k, (file, view) in enumerate(zip(cameras.files, cameras.views, strict=True)):
        theory: list[FloatArray] = []
        for low, high in zip(collector.panel_edges_y_m[:-1] + gap, collector.panel_edges_y_m[1:] - gap, strict=True):
            along = np.linspace(low, high, _ROWS)
            places = image_edges(view.eye_m, along, collector, absorber).reshape(_ROWS, -1)
            for column in places.T[np.isfinite(places).all(axis=0)]:
                points = np.stack([column, along, column**2 / (4 * collector.focal_length_m)], axis=1)
                theory.append(view.project(points))
        own = found.used & (edges.photo == k)
        lines: list[FloatArray] = []
        for number in np.unique(panel[own]):
            for side in (-1.0, 1.0):
                chosen = np.flatnonzero(own & (panel == number) & (edges.side == side))
                chosen = chosen[np.argsort(edges.points_m[chosen, 1])]
                lines.append(view.project(edges.points_m[chosen]))
        image = np.clip(read_luma(file), 0, 255).astype(np.uint8)
        sheets[file.name] = theory_sheet(image, file.name, theory, [line for line in lines if len(line) > 1])
    return sheets
