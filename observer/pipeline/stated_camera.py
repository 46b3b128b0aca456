"""Whether the stated camera fits the targets in the photos: where not, a better one from a few photos."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, MetrologyError, NotConvergedError
from heliogauge.measurement.models import Intrinsic
from heliogauge.running.progress import SilentProgress
from observer.doubts.by_chance import contradicting_sigmas
from observer.doubts.photos import scatter_doubt
from observer.pipeline.reading.photos import FirstLook
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.keys import PhotogrammetryMeasurement
from photogrammetry.pipeline import collect_photos
from photogrammetry.start_values import StartValues

#: Image points that fit so much worse than they were measured make one ask; cameras that are right leave 0.8 to 1.0.
_ASK_FACTOR = 1.3
#: The camera is wrong where they fit so much better with another one ...
_BETTER_SHARE = 0.75
#: ... that differs in one of its numbers by so many sigmas.
_TIMES_SIGMA = 5.0
#: Targets in one plane fit a wrong focal length nearly as well, at other distances: there its own sigma says, freed
#: alone, that it is wrong, from `contradicting_sigmas` and this share of it on (0.05 mrad in the slopes of an LS-2).
_FOCAL_SHARE = 5e-4
#: So does a principal point that is aside by this share of the focal length besides: 5 px of 1,750 move the slopes of
#: 31 rendered photos by 0.12 mrad RMS, this much by 0.05.
_CENTER_SHARE = 1.2e-3
#: Photos from which the camera is estimated, and those for its focal length.
_PHOTOS, _FOCAL_PHOTOS = 24, 100
#: Findings that another camera proves.
_PROVEN = (
    "camera_contradicts_targets",
    "focal_length_contradicts_targets",
    "principal_point_contradicts_targets",
)
_FREE: tuple[Intrinsic, ...] = ("focal_px", "center_x_px", "center_y_px", "k1", "k2")


def stated_camera_doubt(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement, first: FirstLook, n_modules: int = 1
) -> Doubt | None:
    """Say whether the stated camera contradicts the targets, and what some photos say that it is.

    first: What was found in the photos.
    n_modules: Modules of the flight, each of which is asked.
    """
    stated, said = survey.model.camera, None
    if first.targets and len(stated) == 1 and stated[0].free is None:
        if network.solved.image_sigma_factor >= _ASK_FACTOR:
            said = _doubt_by_fit(network, survey, first)
        said = said or _doubt_of_focal_length(network, survey, first, n_modules)
        said = said or _doubt_of_center(network, survey, first, n_modules)
    return said or _scatter_of(network)


def is_camera_wrong(doubt: Doubt | None) -> bool:
    """Return whether a doubt proves the stated camera wrong, by another one that fits the targets."""
    return doubt is not None and doubt.code in _PROVEN


def _scatter_of(network: photogrammetry_pipeline.Result) -> Doubt | None:
    residuals = network.solved.bundle.residuals_px
    rms = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    return scatter_doubt(network.solved.image_sigma_factor, rms, network.camera.focal_x_px)


def _doubt_by_fit(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement, first: FirstLook
) -> Doubt | None:
    """Say with which camera the targets fit much better; None where there is no such camera."""
    factor = network.solved.image_sigma_factor
    found = _with_free(survey, first, _FREE, _PHOTOS)
    if found is None:
        return None
    better = found.solved.image_sigma_factor
    said = _differences(network.camera, found.camera)
    if better > _BETTER_SHARE * factor or not said:
        return None
    free = ", ".join(f'"{name}"' for name in _FREE)
    return Doubt(
        "camera_contradicts_targets",
        f"camera: with the stated one the targets' image points fit {factor:.1f} times worse than they were measured, "
        f"with {', '.join(said)} {better:.1f} times; slopes and absorber are wrong with it. Estimate it from the "
        f"photos: under [camera] free = [{free}], or calibrate the camera",
        {"image_sigma_factor": factor, "image_sigma_with_other_camera_factor": better},
        Severity.SERIOUS,
    )


def _doubt_of_focal_length(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement, first: FirstLook, n_modules: int
) -> Doubt | None:
    """Say whether targets and list have another focal length, however well they fit the stated one."""
    found = _with_free(survey, first, ("focal_px",), _FOCAL_PHOTOS)
    if found is None:
        return None
    was, now = network.camera.focal_x_px, found.camera.focal_x_px
    sigma = float(found.camera.sigma_parameters[0])
    apart = float(np.hypot(sigma, network.camera.sigma_parameters[0]))
    if not sigma > 0 or abs(now - was) < max(contradicting_sigmas(n_modules) * apart, _FOCAL_SHARE * was):
        return None
    return Doubt(
        "focal_length_contradicts_targets",
        f"camera: focal_px = {was:.6g} does not fit: targets and their list say {now:.6g} +- {sigma:.1g} "
        f"({100 * (now / was - 1):+.2f} %), which image points in one plane hardly show; slopes and absorber are wrong "
        'with it. Estimate it from the photos: under [camera] free = ["focal_px"], or calibrate the camera; else look '
        "whether the coordinates are as good as their sigmas",
        {"stated_px": was, "found_px": now, "sigma_found_px": sigma},
        Severity.SERIOUS,
    )


def _doubt_of_center(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement, first: FirstLook, n_modules: int
) -> Doubt | None:
    """Say whether targets and list have another principal point: image points hide it in turns of the camera."""
    found = _with_free(survey, first, ("center_x_px", "center_y_px"), _PHOTOS)
    if found is None:
        return None
    was, now = network.camera.parameters[2:4], found.camera.parameters[2:4]
    sigma = found.camera.sigma_parameters[2:4]
    limit = contradicting_sigmas(2 * n_modules) * np.hypot(sigma, network.camera.sigma_parameters[2:4])
    wrong = (sigma > 0) & (np.abs(now - was) > np.maximum(limit, _CENTER_SHARE * network.camera.focal_x_px))
    if not wrong.any():
        return None
    said = [
        f"center_{axis}_px = {old:.6g} does not fit: targets and their list say {new:.5g} +- {own:.1g}"
        for axis, old, new, own, is_wrong in zip("xy", was, now, sigma, wrong, strict=True)
        if is_wrong
    ]
    return Doubt(
        "principal_point_contradicts_targets",
        f"camera: {', '.join(said)}, which image points in one plane hardly show; slopes and absorber are wrong with "
        'it. Estimate it from the photos: under [camera] free = ["center_x_px", "center_y_px"], or calibrate the '
        "camera",
        {"apart_x_px": float(now[0] - was[0]), "apart_y_px": float(now[1] - was[1])},
        Severity.SERIOUS,
    )


def _with_free(
    survey: PhotogrammetryMeasurement,
    first: FirstLook,
    free: tuple[Intrinsic, ...],
    most: int,
) -> photogrammetry_pipeline.Result | None:
    """Adjust at most so many of the photos with the camera estimated; None where it is not determined."""
    section = survey.model.camera[0].model_copy(update={"free": free, "prior": False, "sigma": {}})
    every = max(1, -(-len(first.targets) // most))
    some = first.targets[::every]
    names = {one.detections.photo for one in some}
    poses = {name: pose for name, pose in first.poses.items() if name in names}
    files = tuple(file for file in survey.photo_files if file.name in names)
    freed = replace(survey, model=survey.model.model_copy(update={"camera": (section,)}), photo_files=files)
    try:
        return photogrammetry_pipeline.run(
            freed,
            photogrammetry_pipeline.Options(jobs=1),
            SilentProgress(),
            measured=collect_photos(some),
            start=StartValues(poses) if len(poses) > 1 else None,
        )
    except MetrologyError:
        return None


def _differences(stated: Camera, found: Camera) -> list[str]:
    """Return the numbers of a camera that contradict the stated ones, as text."""
    apart = np.abs(found.parameters - stated.parameters)
    said = []
    for name, was, now, sigma, off in zip(
        PARAMETER_NAMES, stated.parameters, found.parameters, found.sigma_parameters, apart, strict=True
    ):
        key = {"focal_x_px": "focal_px"}.get(name, name)
        if key in _FREE and off > _TIMES_SIGMA * sigma > 0:
            said.append(f"{key} = {now:.5g} +- {sigma:.1g} instead of {was:.5g}")
    return said


@contextmanager
def explained(cause: Doubt | None = None) -> Iterator[None]:
    """Say what is usually wrong where photos and list of targets cannot be adjusted.

    cause: What is known to be wrong.
    EstimationError: What was raised, with its cause or the usual ones.
    """
    try:
        yield
    except NotConvergedError as error:
        if cause is not None:
            raise EstimationError(f"{cause}; so {error}") from error
        raise EstimationError(
            f"{error}: photos, camera and list of targets do not fit each other well enough to settle. Did the camera "
            "fly fast with a rolling shutter (hover, or fly more slowly), did zoom or focus change, did targets or the "
            "trough move between photos? Or estimate the camera from the photos: under [camera] "
            'free = ["focal_px", "aspect"]'
        ) from error


@contextmanager
def blamed(
    network: photogrammetry_pipeline.Result, survey: PhotogrammetryMeasurement, first: FirstLook
) -> Iterator[None]:
    """Say with an error what cameras and targets have to say, which is often its cause.

    first: What was found in the photos.
    Returns: While what rests on the network is computed.
    EstimationError: What was raised, with the first doubt.
    """
    try:
        yield
    except EstimationError as error:
        camera = stated_camera_doubt(network, survey, first)
        if is_camera_wrong(camera):
            raise EstimationError(f"{camera}; so {error}") from error
        doubts = gather_doubts(camera, network.doubts)
        if not doubts:
            raise
        raise EstimationError(f"{error}; before that: {doubts[0]}") from error
