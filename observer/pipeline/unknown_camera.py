"""Photos of a camera that measurement.toml does not state: its focal length from the list, to start from."""

from collections.abc import Sequence
from dataclasses import replace

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.running.progress import Progress
from observer.pipeline.inputs import Inputs
from observer.pipeline.reading.photos import measure_targets
from observer.pipeline.target_list import focal_of_photos
from photogrammetry.start_values import guessed_camera

#: Photos that are asked, evenly over the flight.
_MOST_ASKED = 12


def start_unknown_camera(inputs: Inputs, jobs: int | None, progress: Progress) -> Inputs:
    """Give a camera that is to calibrate itself the focal length that a few photos of the list show.

    From a guess the network of targets in one plane, seen from above, falls into a camera that is none: its focal
    length and its distance from the plane are nearly one unknown.

    jobs: Photos side by side.
    Returns: With a camera to start from, the same things estimated; as they were
        where a camera is known, or several are described.
    """
    sections = inputs.survey.model.camera
    if len(sections) != 1 or sections[0].is_known or inputs.corners is not None or not inputs.finder.measures_alone:
        return inputs
    files = inputs.survey.photo_files
    first = measure_targets(files[:: -(-len(files) // _MOST_ASKED)], inputs.finder, jobs=jobs, progress=progress)
    sizes = {one.size_px for one in first.targets}
    if len(sizes) != 1:
        return inputs
    guess = guessed_camera(*sizes.pop())
    found = focal_of_photos(first, inputs.finder, guess)
    if found is None:
        return inputs
    camera = replace(guess, focal_x_px=found.focal_px, focal_y_px=found.focal_px)
    return _starting_from(inputs, camera)


def start_unknown_camera_of_each(modules: Sequence[Inputs], jobs: int | None, progress: Progress) -> list[Inputs]:
    """Give the one camera of several modules in the same photos what the first of them shows of its focal length.

    jobs: Photos side by side.
    Returns: The modules with a camera to start from; as they were where it is known, or none of them shows it.
    """
    for one in modules:
        started = start_unknown_camera(one, jobs, progress)
        if started is not one:
            [camera] = {*started.finder.camera_of.values()}
            return [_starting_from(each, camera) for each in modules]
    return list(modules)


def _starting_from(inputs: Inputs, camera: Camera) -> Inputs:
    """Return a measurement whose camera is estimated from the one given."""
    [section] = inputs.survey.model.camera
    section = section.model_copy(update={"focal_px": camera.focal_x_px, "free": section.estimated})
    survey = replace(inputs.survey, model=inputs.survey.model.model_copy(update={"camera": (section,)}))
    finder = replace(inputs.finder, camera_of={file.name: camera for file in inputs.survey.photo_files})
    return replace(inputs, survey=survey, finder=finder)


def unknown_camera_doubt(inputs: Inputs) -> Doubt | None:
    """Say that the camera is not known and the photos do not show its focal length, after `start_unknown_camera`."""
    sections = inputs.survey.model.camera
    if len(sections) != 1 or sections[0].is_known or inputs.finder.camera_of:
        return None
    return Doubt(
        "camera_not_determined",
        "camera: none is stated ([camera] file, or focal_px), and the photos do not show its focal length, as where "
        "targets in one plane are seen straight from above: state the camera, or add photos from both sides of the "
        "trough with the camera aimed at its middle, some of them turned by 90 degrees",
    )
