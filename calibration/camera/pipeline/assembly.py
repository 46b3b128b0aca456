"""What was adjusted becomes a result: photos, shape of the board, uncertainty over the image."""

import numpy as np

from calibration.camera.files.findings import (
    BoardShape,
    CommonErrors,
    Intrinsic,
    PhotoResult,
    Quality,
    rms_length,
    sigma_of_shape,
)
from calibration.camera.files.result import Result
from calibration.camera.judgement.network import coverage
from calibration.camera.judgement.projection_sigma import radial_profile, sigma_map
from calibration.camera.pipeline.solving import Solved


def assemble_result(name: str, camera_name: str, solved: Solved) -> Result:
    """Return the result without what is checked afterwards.

    name, camera_name: Of the measurement, and of the camera in cameras.json.
    """
    network, adjusted = solved.network, solved.adjusted
    mixed, state = adjusted.mixed, adjusted.state
    camera = mixed.camera
    whole = network.observations()
    residuals = np.full((whole.n, 2), np.nan)
    residuals[adjusted.kept] = mixed.residuals_px
    photos = tuple(
        PhotoResult(
            one.photo,
            state.cam_from_world(i),
            mixed.covariance_poses[i],
            one.index,
            one.pixels_px,
            residuals[whole.photo_index == i],
            one.covariance_px2,
            float(mixed.sizes.components.noise[i]),
            float(solved.apart_px[i]),
            float(solved.apart_expected_px[i]),
        )
        for i, one in enumerate(network.points)
    )
    shape = BoardShape(
        network.board,
        network.seen,
        state.points_m,
        sigma_of_shape(state.points_m, mixed.covariance_points_m2)
        if adjusted.refined
        else np.zeros((network.seen.size, 3)),
        mixed.table.n_rays,
        mixed.prior_sigma_m,
        mixed.datum,
    )
    sizes = mixed.sizes
    common = CommonErrors(sizes.names, sizes.components.effects, sizes.components.point, network.board.pitch_m)
    quality = Quality(
        rms_length(mixed.residuals_px), adjusted.rms_as_drawn_px, adjusted.factor, mixed.redundancy, adjusted.rejected
    )
    pixels = whole.pixels_px[adjusted.kept]
    distance = float(np.median([np.linalg.norm(photo.cam_from_board.translation_m) for photo in photos]))
    tests = tuple(
        Intrinsic(one.name, one.value, one.sigma, one.significance, one.rival, one.correlation)
        for one in mixed.intrinsic_tests
    )
    return Result(
        camera_name,
        camera,
        tests,
        photos,
        {},
        shape,
        common,
        quality,
        sigma_map(camera, distance),
        radial_profile(camera, pixels),
        coverage(camera, pixels),
        name=name,
    )
