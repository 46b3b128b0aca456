"""All photos of a measurement to edges of the reflection and bearings of the tube."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.camera import Camera
from heliogauge.images import read_image
from heliogauge.progress import Progress
from heliogauge.rigid import RigidTransform
from observer.absorber_bearings import Bearings, tube_bearings
from observer.reflection import Expectation, ReflectionEdges, joined, reflection_edges


@dataclass(frozen=True, slots=True, eq=False)
class SeenInPhotos:
    """What the photos show of the absorber.

    Parameters
    ----------
    edges : ReflectionEdges
        Edges that may be those of its reflection.
    bearings : Bearings
        Directions of the tube itself.
    """

    edges: ReflectionEdges
    bearings: Bearings


def look_at_photos(
    files: Sequence[Path],
    views: Sequence[tuple[Camera, RigidTransform]],
    expected: Expectation,
    *,
    jobs: int | None,
    progress: Progress,
) -> SeenInPhotos:
    """Find the absorber and its reflection in all photos.

    Parameters
    ----------
    files : sequence of Path
        The photos.
    views : sequence of (Camera, RigidTransform)
        Camera and ``cam_from_frame`` of each.
    expected : Expectation
        Collector, absorber and rows.
    jobs : int or None
        Photos side by side.
    progress : Progress
        Told of each photo.

    Returns
    -------
    SeenInPhotos
        Edges and bearings of all photos.

    Raises
    ------
    InputError
        A photo cannot be read.
    """

    def one(number: int) -> tuple[ReflectionEdges, Bearings]:
        image = read_image(files[number])
        view = views[number]
        return reflection_edges(image, number, view, expected), tube_bearings(image, number, view, expected)

    found = []
    with progress.stage("find the reflection", len(files)) as stage, ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(one, number) for number in range(len(files))]
        try:
            for future in waiting:
                found.append(future.result())
                stage.advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    bearings = [part for _, part in found]
    return SeenInPhotos(
        joined([part for part, _ in found]),
        Bearings(*(np.concatenate([getattr(one, name) for one in bearings]) for name in Bearings.__slots__)),
    )
