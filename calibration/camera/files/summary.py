"""The headline numbers of a calibration, and the lines for the terminal."""

import numpy as np

from calibration.camera.files.findings import Findings
from calibration.camera.judgement.comparison import Comparison
from heliogauge.reporting.notation import number_text
from heliogauge.results.frame import Numbers

#: Differences that chance makes less often than this are called more than chance.
_UNLIKELY = 0.01
#: Intrinsics without a unit in their name get one that `summary.json` knows.
_KEYS = {name: f"{name}_factor" for name in ("k1", "k2", "k3", "p1", "p2")} | {"aspect": "aspect_ratio"}


def headline_numbers(result: Findings) -> Numbers:
    """Return the headline numbers with their sigmas."""
    quality, sigma, camera = result.quality, result.sigma, result.camera
    numbers: dict[str, float | int | None] = {
        "residual_rms_px": quality.rms_px,
        "residual_rms_board_as_drawn_px": quality.rms_as_drawn_px,
        "photos_kept_apart_rms_px": result.kept_apart_px,
        "held_out_rms_px": result.held_out_px,
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
        "board_departure_rms_share": float(_departure(result)) if result.shape.has_drawing else float("nan"),
    }
    return numbers if result.comparison is None else numbers | comparison_numbers(result.comparison)


def comparison_numbers(one: Comparison) -> dict[str, float | int | None]:
    """Return how two calibrations differ."""
    return {
        "compared_angle_rms_rad": one.rms_rad,
        "compared_angle_largest_rad": one.largest_rad,
        "compared_angle_expected_rad": one.expected_rad,
        "compared_angle_with_rotation_rms_rad": one.raw_rms_rad,
        "compared_angle_with_rotation_largest_rad": one.raw_largest_rad,
        "compared_angle_with_rotation_expected_rad": one.raw_expected_rad,
        "compared_rotation_rad": float(np.linalg.norm(one.rotation_rad)),
        "compared_chi_square_ratio": one.chi_square / max(one.freedom, 1),
        "compared_chance_share": one.chance,
    }


def comparison_reasons(one: Comparison) -> dict[str, str]:
    """Return why numbers of `comparison_numbers` are missing."""
    if np.isfinite(one.chance):
        return {}
    return dict.fromkeys(("compared_chi_square_ratio", "compared_chance_share"), "neither calibration has a covariance")


def not_determined(result: Findings) -> dict[str, str]:
    """Return why numbers of `headline_numbers` are missing."""
    missing: dict[str, str] = {}
    if not np.isfinite(result.quality.rms_as_drawn_px):
        keys = ("residual_rms_board_as_drawn_px", "board_departure_rms_share")
        missing |= dict.fromkeys(keys, "nothing was known of the targets' places")
    if not result.held_out:
        missing["held_out_rms_px"] = "no photo was held out"
    if result.comparison is not None:
        missing |= comparison_reasons(result.comparison)
    if not np.isfinite(result.kept_apart_px):
        missing["photos_kept_apart_rms_px"] = "not asked for, or too few photos"
    return missing


def _departure(result: Findings) -> float:
    """RMS distance of points from where they were drawn, in pitches."""
    return float(np.sqrt((result.shape.departure_m**2).sum(axis=1).mean())) / result.shape.board.pitch_m


def texts(result: Findings) -> dict[str, str]:
    """Return what must be known beside the numbers: board, datum, units, meaning of sigma."""
    board = result.shape.board
    held = "estimated, smooth departures and each point's own" if result.shape.prior_sigma_m.any() else "held as drawn"
    unit = (
        "metres" if board.is_metric else "squares (pitches) of the board: names of lengths in the files end with pitch"
    )
    return {
        "board": f"{board.describe()}; its shape is {held}",
        "datum": _datum_text(result),
        "unit": unit,
        "residual": "root mean square length of predicted minus measured image points",
        "kept_apart": "camera and board from the other photos, only the pose of the photo fitted, none of its points "
        "rejected",
        "sigma": "1 standard deviation; errors common to a photo, focal length and centre that settle anew with each, "
        "and the board's smooth departure are random effects whose sizes the photos themselves give",
        "sigma_of_points": "points.csv: of the board's shape, position, rotation and scale of the whole taken out",
        "aspect": "focal_y_px / focal_x_px - 1",
    }


def _datum_text(result: Findings) -> str:
    shape = result.shape
    if np.isinf(shape.prior_sigma_m).any():
        return shape.datum
    if not shape.prior_sigma_m.any():
        return "the board as drawn"
    x, _, z = shape.prior_sigma_m / shape.board.pitch_m
    return (
        f"the board's points as a whole; they are as drawn to {x:.2g} pitches in its plane and {z:.2g} across (1 sigma)"
    )


def headline_text(result: Findings) -> str:
    """Return the headline numbers as lines for the terminal."""
    quality, camera, sigma = result.quality, result.camera, result.sigma
    s = camera.sigma_parameters
    apart = result.kept_apart_px
    lines = [
        f"{result.name}: {camera.width_px} x {camera.height_px} px, {len(result.photos)} photos, "
        f"{sum(int(photo.used.sum()) for photo in result.photos)} points",
        f"  residuals        {quality.rms_px:.4f} px rms{_drawn_text(quality.rms_as_drawn_px)}",
        f"  focal length     {number_text(camera.focal_x_px, s[0], 'px')}, "
        f"{number_text(camera.focal_y_px, s[1], 'px')}",
        f"  principal point  {number_text(camera.center_x_px, s[2], 'px')}, "
        f"{number_text(camera.center_y_px, s[3], 'px')}",
        f"  line of sight    +- {1e3 * sigma.rms_free_rad:.2g} mrad rms over the image, without a common rotation",
    ]
    if result.shape.has_drawing:
        lines.append(f"  board            {100 * _departure(result):.2g} % of a pitch rms from as drawn")
    if np.isfinite(apart):
        lines.insert(2, f"  photos kept apart {apart:.4f} px rms, only their pose fitted")
    lines += [
        f"  held out         {one.name}: {one.rms_px:.4f} px rms over {one.count} points" for one in result.held_out
    ]
    if len(result.held_out) > 1:
        lines.append(f"  held out         {result.held_out_px:.4f} px rms together")
    if result.comparison is not None:
        lines += comparison_lines(result.comparison)
    return "\n".join(lines)


def _drawn_text(rms_px: float) -> str:
    return f"; board as drawn {rms_px:.4f} px" if np.isfinite(rms_px) else ""


def comparison_lines(one: Comparison) -> list[str]:
    """Return how two calibrations differ, as lines for the terminal."""
    lines = [
        f"  compared         {1e3 * one.rms_rad:.2g} mrad rms, {1e3 * one.largest_rad:.2g} mrad at most "
        f"(expected {1e3 * one.expected_rad:.2g} rms), best rotation taken out",
        f"                   {1e3 * one.raw_rms_rad:.2g} mrad rms, {1e3 * one.raw_largest_rad:.2g} mrad at most "
        f"(expected {1e3 * one.raw_expected_rad:.2g} rms) with it",
    ]
    if np.isfinite(one.chance):
        lines.append(
            f"                   chi-square {one.chi_square:.3g} for {one.freedom} degrees of freedom: "
            f"{verdict_text(one)} (probability {one.chance:.2g})"
        )
    return lines


def verdict_text(one: Comparison) -> str:
    """Say whether two calibrations differ by more than chance."""
    if not np.isfinite(one.chance):
        return "whether the difference means something is not known: neither calibration has a covariance"
    return "more than chance" if one.chance < _UNLIKELY else "no more than chance"
