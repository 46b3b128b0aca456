"""What was adjusted becomes a result: photos, shape of the board, uncertainty over the image."""

import numpy as np

from calibration.camera.files.result import (
    BoardShape,
    Intrinsic,
    PhotoResult,
    Quality,
    Result,
    rms_length,
    sigma_of_shape,
)
from calibration.camera.judgement.network import coverage
from calibration.camera.judgement.projection_sigma import radial_profile, sigma_map
from calibration.camera.pipeline.solving import Solved
from photogrammetry.bundle import statistics


def assemble_result(name: str, camera_name: str, solved: Solved) -> Result:
    """Return the result without what is checked afterwards.

    name, camera_name: Of the measurement, and of the camera in cameras.json.
    """
    network, adjusted, apart = solved.network, solved.adjusted, solved.apart_px
    bundle = adjusted.bundle
    camera = bundle.cameras[0]
    whole = network.observations()
    residuals = np.full((whole.n, 2), np.nan)
    residuals[adjusted.kept] = bundle.residuals_px
    photos = tuple(
        PhotoResult(
            one.photo,
            bundle.state.cam_from_world(i),
            bundle.covariance.poses[i],
            one.index,
            one.pixels_px,
            residuals[whole.photo_index == i],
            float(apart[i]),
        )
        for i, one in enumerate(network.points)
    )
    joint = bundle.covariance.joint(targets=np.arange(network.seen.size))
    shape = BoardShape(
        network.board,
        network.seen,
        bundle.state.points_m,
        np.zeros((network.seen.size, 3))
        if not adjusted.prior_sigma_m.any()
        else sigma_of_shape(bundle.state.points_m, joint),
        bundle.problem.observations.n_rays,
        adjusted.prior_sigma_m,
        bundle.datum,
    )
    quality = Quality(
        rms_length(bundle.residuals_px), adjusted.rms_as_drawn_px, adjusted.factor, bundle.redundancy, adjusted.rejected
    )
    pixels = whole.pixels_px[adjusted.kept]
    distance = float(np.median([np.linalg.norm(photo.cam_from_board.translation_m) for photo in photos]))
    tests = tuple(
        Intrinsic(one.name, one.value, one.sigma, one.significance, one.rival, one.correlation)
        for one in statistics.examine_intrinsics(bundle)
    )
    return Result(
        camera_name,
        camera,
        tests,
        photos,
        {},
        shape,
        quality,
        sigma_map(camera, distance),
        radial_profile(camera, pixels),
        coverage(camera, pixels),
        name=name,
    )
