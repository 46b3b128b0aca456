"""Poses of all photos in the trough's frame from one adjustment of the targets, and what refuses it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.running.progress import Progress
from observer.photo_edges.views import View
from observer.pipeline.stated_camera import explained
from observer.pipeline.target_list import CheckedList, refuse_loose_list
from observer.slopes.pose_modes import Photos
from observer.trough.collector import Collector
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.pipeline import collect_photos


@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """Cameras and targets as adjusted.

    network: The adjustment.
    photos: Poses with their joint covariance.
    views: Camera and pose of each photo.
    files: Their files.
    """

    network: photogrammetry_pipeline.Result
    photos: Photos
    views: tuple[View, ...]
    files: tuple[Path, ...]

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


def adjust_cameras(listed: CheckedList, collector: Collector, jobs: int | None, progress: Progress) -> Cameras:
    """Adjust poses, targets and, where it is asked for, the camera.

    jobs: Photos side by side.
    InputError: The list of targets is upside down.
    EstimationError: The photos do not hang together, or the trough's frame is free to turn.
    """
    first = listed.first
    with explained():
        network = photogrammetry_pipeline.run(
            listed.survey,
            photogrammetry_pipeline.Options(jobs=jobs),
            progress,
            measured=collect_photos(first.targets) if first.targets else None,
            start=first.start,
        )
    cameras = Cameras.of(network, listed.survey.photo_files)
    refuse_loose_list(network, listed.survey, collector)
    return cameras
