"""Poses of all photos in the trough's frame from one adjustment of the targets, and what refuses it.

Before a collector that turns, poses by the corners of panels are then tied to the readings of an inclinometer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError
from heliogauge.running.progress import Progress
from observer.photo_edges.views import MovingView, View
from observer.pipeline.inputs import Inputs
from observer.pipeline.rolling_shutter import adjust_rolling, shutter_doubts, unstated_doubt
from observer.pipeline.stated_camera import explained
from observer.pipeline.target_list import (
    CheckedList,
    contradicted_doubt,
    contradicted_places,
    refuse_loose_list,
)
from observer.pipeline.tilts import LEAST_READINGS, Tilts
from observer.pipeline.unknown_camera import unknown_camera_doubt
from observer.shutter.readout import RowMotions
from observer.slopes.pose_modes import Photos
from observer.turning.far_camera import TiltReadings
from observer.turning.tied_poses import CONTRADICTED, Turning, compare_turning, tie_poses
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.pipeline import MeasuredPhotos, collect_photos
from photogrammetry.start_values import LeftOut


@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """Cameras and targets as adjusted.

    network: The adjustment.
    photos: Poses with their joint covariance.
    views: Camera and pose of each photo.
    files: Their files.
    motions: How the cameras move while they read their rows; None: all rows at once.
    doubts: What contradicts how the photos were read, and the list of targets.
    """

    network: photogrammetry_pipeline.Result
    photos: Photos
    views: tuple[View, ...]
    files: tuple[Path, ...]
    motions: RowMotions | None = None
    doubts: tuple[Doubt, ...] = ()

    @classmethod
    def of(cls, network: photogrammetry_pipeline.Result, files: Sequence[Path]) -> "Cameras":
        """Return the cameras of an adjusted network.

        files: Photos by whose names the network knows them.
        """
        bundle, by_name = network.solved.bundle, {file.name: file for file in files}
        poses = tuple(bundle.cam_from_world)
        covariance = bundle.covariance.joint((), np.arange(len(poses)))
        views = tuple(View(bundle.cameras[k], pose) for k, pose in zip(bundle.problem.camera_index, poses, strict=True))
        names = bundle.problem.observations.photos
        return cls(network, Photos(poses, covariance), views, tuple(by_name[name] for name in names))

    def moving(self, motions: RowMotions) -> "Cameras":
        """Return the same, moving while they read their rows, with what is uncertain of that."""
        views = tuple(MovingView(*view, motion) for view, motion in zip(self.views, motions.motions_m, strict=True))
        rotations = np.array([pose.rotation for pose in self.photos.poses])
        covariance = self.photos.covariance + motions.pose_covariance(rotations)
        photos = replace(self.photos, covariance=covariance, moving=views)
        return replace(self, photos=photos, views=views, motions=motions)


def adjust_cameras(
    listed: CheckedList, inputs: Inputs, jobs: int | None, progress: Progress
) -> tuple[CheckedList, Cameras]:
    """Adjust poses, targets and, where it is asked for, the camera and its readout.

    jobs: Photos side by side.
    Returns: Without the listed places that contradict the others, where it can be told which do.
    InputError: The list of targets is upside down.
    EstimationError: The photos do not hang together, or the trough's frame is free to turn.
    """
    cameras = _adjusted(listed, inputs, jobs, progress)
    while (found := contradicted_places(cameras.network, listed)) is not None and found.told:
        listed = listed.without_places(found.targets)
        cameras = _adjusted(listed, inputs, jobs, progress)
    refuse_loose_list(cameras.network, listed, inputs.collector)
    doubt = contradicted_doubt(listed, cameras.network, found)
    return listed, replace(cameras, doubts=gather_doubts(doubt, cameras.doubts))


def _adjusted(listed: CheckedList, inputs: Inputs, jobs: int | None, progress: Progress) -> Cameras:
    first = listed.first

    def adjusted(measured: MeasuredPhotos | None) -> photogrammetry_pipeline.Result:
        return photogrammetry_pipeline.run(
            listed.survey,
            photogrammetry_pipeline.Options(jobs=jobs),
            progress,
            measured=measured,
            start=first.start,
        )

    measured, shutter = collect_photos(first.targets) if first.targets else None, inputs.shutter
    with explained(unknown_camera_doubt(inputs)):
        if measured is None or shutter is None:
            network = adjusted(measured)
            cameras = Cameras.of(network, listed.survey.photo_files)
            doubt = None
            if inputs.tilts is None:
                doubt = unstated_doubt(network, can_be_stated=measured is not None)
            cameras = replace(cameras, doubts=gather_doubts(doubt))
        else:
            rolled = adjust_rolling(adjusted, measured, shutter)
            network = rolled.network
            cameras = Cameras.of(network, listed.survey.photo_files).moving(rolled.motions)
            cameras = replace(cameras, doubts=shutter_doubts(rolled, shutter))
    return cameras


def adjust_turning(
    listed: CheckedList, inputs: Inputs, jobs: int | None, progress: Progress
) -> tuple[CheckedList, Cameras]:
    """Adjust the photos of a fixed camera before a collector that turns, and tie their poses to the readings.

    jobs: Photos side by side.
    Returns: Without the photos whose corners and reading contradict each other; cameras with the tied poses.
    EstimationError: The readings contradict how the collector turns in the photos.
    """
    listed, cameras = adjust_cameras(listed, inputs, jobs, progress)
    tilts = inputs.tilts
    if tilts is None:
        return listed, cameras
    turning = _compare(cameras, tilts)
    _refuse_other_turning(turning, tilts)
    doubts = [*tilts.doubts]
    out = np.flatnonzero(np.isfinite(turning.over_sigma) & ~turning.used).tolist()
    if out:
        sigmas = {cameras.files[k].name: abs(float(turning.over_sigma[k])) for k in out}
        doubts.append(_left_out_doubt(sigmas))
        listed = _without(listed, sigmas)
        listed, cameras = adjust_cameras(listed, inputs, jobs, progress)
        turning = _compare(cameras, tilts)
    with progress.stage("tie to tilts"):
        names = [file.name for file in cameras.files]
        tied = tie_poses(cameras.photos, tilts.of(names), tilts.camera, turning)
    views = tuple(View(view.camera, pose) for view, pose in zip(cameras.views, tied.photos.poses, strict=True))
    found = gather_doubts(listed.doubts, doubts, _without_doubt(tilts.of(names), names))
    return replace(listed, doubts=found), replace(cameras, photos=tied.photos, views=views)


def _compare(cameras: Cameras, tilts: Tilts) -> Turning:
    readings = tilts.of([file.name for file in cameras.files])
    return compare_turning(cameras.photos, readings, tilts.camera.camera)


def _without(listed: CheckedList, sigmas: Mapping[str, float]) -> CheckedList:
    """Leave out photos with the reason."""
    first = listed.first
    targets = []
    for one in first.targets:
        name = one.detections.photo
        if name in sigmas:
            reason = f"left out: corners of its panels and the reading of its tilt differ by {sigmas[name]:.0f} sigmas"
            none = one.detections.chosen(np.zeros(0, dtype=np.intp))
            one = replace(one, detections=none, ellipses_px2=np.zeros((0, 2, 2)), refused=(LeftOut(name, reason),))
        targets.append(one)
    poses = {name: pose for name, pose in first.poses.items() if name not in sigmas}
    files = tuple(file for file in listed.survey.photo_files if file.name not in sigmas)
    survey = replace(listed.survey, photo_files=files)
    return replace(listed, survey=survey, first=replace(first, targets=tuple(targets), poses=poses))


def _refuse_other_turning(turning: Turning, tilts: Tilts) -> None:
    """Refuse readings that are not those of the photos.

    EstimationError: The collector turned the other way, or by another amount; or most readings contradict the photos.
    """
    has_reading = np.isfinite(turning.over_sigma)
    count, used = int(np.count_nonzero(has_reading)), int(np.count_nonzero(turning.used))
    sigma = float(np.hypot(turning.sigma_scale, tilts.camera.sigma[-1]))
    if used < max(LEAST_READINGS, count / 2):
        raise EstimationError(
            f"tilts: {count - used} of {count} readings contradict how the collector turns in the photos; does "
            f"{tilts.file} belong to these photos, name by name or with the right time_offset_s?"
        )
    if abs(turning.scale + 1) < CONTRADICTED * sigma:
        raise EstimationError(
            "tilts: in the photos the collector turns the other way; set left_handed = "
            f"{str(not tilts.left_handed).lower()}, or turn the frame of the collector so that its +y is where its "
            "-y is now"
        )
    if abs(turning.scale - 1) > CONTRADICTED * sigma:
        raise EstimationError(
            f"tilts: in the photos the collector turns by {turning.scale:.3f} +- {turning.sigma_scale:.3f} of what "
            f"{tilts.file} says; are the readings degrees, of these photos, and distance_m and the camera's focal "
            "length right?"
        )


def _left_out_doubt(sigmas: Mapping[str, float]) -> Doubt:
    worst = max(sigmas, key=lambda name: sigmas[name])
    some = ", ".join(list(sigmas)[:5]) + (" ..." if len(sigmas) > 5 else "")
    text = (
        f"{len(sigmas)} photos were left out: corners of panels and the reading of the tilt contradict each other, "
        f"in {worst} by {sigmas[worst]:.0f} sigmas: {some}"
    )
    return Doubt("photos_contradict_tilts", text, {"photos_count": len(sigmas)})


def _without_doubt(readings: TiltReadings, names: Sequence[str]) -> Doubt | None:
    out = [name for name, tilt in zip(names, readings.tilt_rad.tolist(), strict=True) if not np.isfinite(tilt)]
    if not out:
        return None
    text = f"{len(out)} photos have no reading of their tilt; their poses come from the corners alone: {out[0]} ..."
    return Doubt("photos_without_tilt", text, {"photos_count": len(out)}, Severity.NOTE)
