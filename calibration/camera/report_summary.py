"""The headline numbers of a calibration, its tables on disk, and what the terminal says."""

from pathlib import Path

import numpy as np

from calibration.camera.result import Result
from heliogauge.flags import SampleFlag
from heliogauge.notation import number_text
from heliogauge.store import (
    PhotoPose,
    PointTable,
    Summary,
    write_cameras_json,
    write_points_csv,
    write_summary,
    write_table_csv,
)

#: Intrinsics without a unit in their name get one that `summary.json` knows.
_KEYS = {name: f"{name}_factor" for name in ("k1", "k2", "k3", "p1", "p2")} | {"aspect": "aspect_ratio"}


def write_tables(result: Result, folder: Path) -> None:
    """Write cameras.json, points.csv, image_points.csv and summary.json.

    Parameters
    ----------
    result : Result
        A calibration.
    folder : Path
        An existing folder.
    """
    poses = {
        photo.name: PhotoPose(result.camera_name, photo.cam_from_board, photo.covariance, photo.rms_px)
        for photo in result.photos
    }
    write_cameras_json(folder / "cameras.json", {result.camera_name: result.camera}, poses)
    shape = result.shape
    every = shape.board.names
    names = tuple(every[i] for i in shape.seen)
    flags = np.zeros(len(names), dtype=np.uint32)
    write_points_csv(
        folder / "points.csv", PointTable(names, shape.points_m, shape.sigma_m, shape.n_rays.astype(np.int64), flags)
    )
    columns: dict[str, list[object]] = {key: [] for key in _IMAGE_COLUMNS}
    for photo in result.photos:
        kept = np.where(photo.used, 0, int(SampleFlag.OUTLIER))
        rows = (
            [photo.name] * photo.index.size,
            [every[i] for i in photo.index],
            *photo.pixels_px.T.tolist(),
            *photo.residuals_px.T.tolist(),
            kept.tolist(),
        )
        for key, values in zip(_IMAGE_COLUMNS, rows, strict=True):
            columns[key] += values
    write_table_csv(folder / "image_points.csv", columns)
    write_summary(folder / "summary.json", summarise(result))


_IMAGE_COLUMNS = ("image", "target", "x_px", "y_px", "residual_x_px", "residual_y_px", "flag")


def summarise(result: Result) -> Summary:
    """Collect the headline numbers with their sigmas, warnings and provenance.

    Parameters
    ----------
    result : Result
        A calibration.

    Returns
    -------
    Summary
        For summary.json.
    """
    quality, sigma, camera = result.quality, result.sigma, result.camera
    numbers: dict[str, float | int | None] = {
        "residual_rms_px": quality.rms_px,
        "residual_rms_board_as_drawn_px": quality.rms_as_drawn_px,
        "photos_kept_apart_rms_px": result.kept_apart_px,
        "focal_x_px": camera.focal_x_px,
        "sigma_focal_x_px": float(camera.sigma_parameters[0]),
        "focal_y_px": camera.focal_y_px,
        "sigma_focal_y_px": float(camera.sigma_parameters[1]),
        "center_x_px": camera.center_x_px,
        "sigma_center_x_px": float(camera.sigma_parameters[2]),
        "center_y_px": camera.center_y_px,
        "sigma_center_y_px": float(camera.sigma_parameters[3]),
    }
    for one in result.intrinsics:
        if one.name in _KEYS:
            numbers |= {_KEYS[one.name]: one.value, f"sigma_{_KEYS[one.name]}": one.sigma}
    numbers |= {
        "sigma_ray_rms_rad": sigma.rms_ray_rad,
        "sigma_ray_without_rotation_rms_rad": sigma.rms_free_rad,
        "sigma_projection_largest_px": sigma.worst_projection_px,
        "covered_share": result.coverage.share,
        "covered_radius_share": result.coverage.radius_share,
        "photos_count": len(result.photos),
        "left_out_photos_count": len(result.left_out),
        "image_points_count": int(sum(photo.used.sum() for photo in result.photos)),
        "rejected_points_count": len(quality.rejected),
        "redundancy_count": quality.redundancy,
        "residual_over_noise_ratio": quality.sigma_factor_ratio,
        "board_departure_rms_share": float(_departure(result)),
    }
    if result.comparison is not None:
        numbers |= {
            "compared_angle_rms_rad": result.comparison.rms_rad,
            "compared_angle_largest_rad": result.comparison.largest_rad,
            "compared_angle_expected_rad": result.comparison.expected_rad,
        }
    missing = {}
    if not np.isfinite(result.kept_apart_px):
        missing["photos_kept_apart_rms_px"] = "not asked for, or too few photos"
    return Summary(
        kind="camera",
        name=result.name,
        numbers=numbers,
        texts=_texts(result),
        warnings=result.warnings,
        durations_s=result.durations_s,
        input_sha256=result.input_sha256,
        not_determined=missing,
    )


def _departure(result: Result) -> float:
    """RMS distance of points from where they were drawn, in pitches."""
    return float(np.sqrt((result.shape.departure_m**2).sum(axis=1).mean())) / result.shape.board.pitch_m


def _texts(result: Result) -> dict[str, str]:
    board = result.shape.board
    held = "held as drawn" if not result.shape.prior_sigma_m.any() else "estimated point by point"
    unit = "metres" if board.is_metric else "squares (pitches) of the board: lengths in cameras.json and points.csv too"
    x, _, z = result.shape.prior_sigma_m / board.pitch_m
    texts = {
        "board": f"{board.describe()}; its shape is {held}",
        "datum": f"the board as drawn, each point with a sigma of {x:.2g} pitches in its plane and {z:.2g} across"
        if result.shape.prior_sigma_m.any()
        else "the board as drawn",
        "unit": unit,
        "residual": "root mean square length of predicted minus measured image points",
        "kept_apart": "camera and board from the other photos, only the pose of the photo fitted, none of its points "
        "rejected",
        "sigma": "1 standard deviation; corners' sigmas from the noise of their pixels times residual_over_noise_ratio",
        "sigma_of_points": "points.csv: of the board's shape, position, rotation and scale of the whole taken out",
        "aspect": "focal_y_px / focal_x_px - 1",
    }
    return texts | {f"left out {name}": reason for name, reason in result.left_out.items()}


def headline_text(result: Result) -> str:
    """Return the headline numbers as lines for the terminal.

    Parameters
    ----------
    result : Result
        A calibration.

    Returns
    -------
    str
        Lines.
    """
    quality, camera, sigma = result.quality, result.camera, result.sigma
    s = camera.sigma_parameters
    apart = result.kept_apart_px
    lines = [
        f"{result.name}: {camera.width_px} x {camera.height_px} px, {len(result.photos)} photos, "
        f"{sum(int(photo.used.sum()) for photo in result.photos)} points",
        f"  residuals        {quality.rms_px:.4f} px rms; board as drawn {quality.rms_as_drawn_px:.4f} px",
        f"  focal length     {number_text(camera.focal_x_px, s[0], 'px')}, "
        f"{number_text(camera.focal_y_px, s[1], 'px')}",
        f"  principal point  {number_text(camera.center_x_px, s[2], 'px')}, "
        f"{number_text(camera.center_y_px, s[3], 'px')}",
        f"  line of sight    +- {1e3 * sigma.rms_free_rad:.2g} mrad rms over the image, without a common rotation",
        f"  board            {100 * _departure(result):.2g} % of a pitch rms from as drawn",
    ]
    if np.isfinite(apart):
        lines.insert(2, f"  photos kept apart {apart:.4f} px rms, only their pose fitted")
    if result.comparison is not None:
        one = result.comparison
        lines.append(
            f"  compared         {1e3 * one.rms_rad:.2g} mrad rms, {1e3 * one.largest_rad:.2g} mrad at most "
            f"(expected {1e3 * one.expected_rad:.2g}), best rotation taken out"
        )
    return "\n".join(lines)
