"""What the command line says of a network."""

from heliogauge.store import Summary


def headline_text(summary: Summary) -> str:
    """Say the most important numbers in a few lines for the terminal.

    Parameters
    ----------
    summary : Summary
        The summary.

    Returns
    -------
    str
        Lines with values and what they refer to.
    """
    numbers = summary.numbers

    def said(key: str, factor: float, form: str, unit: str = "") -> str:
        value = numbers[key]
        return summary.not_determined[key] if value is None else format(factor * float(value), form) + unit

    ratio = numbers["length_error_sigma_ratio"]
    times = "" if ratio is None else f", {ratio:.1f} times their sigma"
    lines = [
        f"{summary.name}: {numbers['points_count']} points from {numbers['photos_count']} photos",
        f"  residuals        {said('image_residual_rms_px', 1, '.3f')} px RMS "
        f"({numbers['image_points_count']} image points), sigma0 {said('sigma0_ratio', 1, '.3f')}",
        f"  sigma of points  x {said('point_sigma_x_rms_m', 1e3, '.4f')}   y {said('point_sigma_y_rms_m', 1e3, '.4f')}"
        f"   z {said('point_sigma_z_rms_m', 1e3, '.4f')} mm",
        f"  largest extent   {said('extent_m', 1, '.3f')} m; relative precision 1:"
        f"{said('relative_precision_ratio', 1, '.0f')}",
        f"  scale bars       used: {said('scale_bar_residual_rms_m', 1e3, '.3f', ' mm RMS')}; "
        f"kept apart: {said('length_error_rms_m', 1e3, '.3f', ' mm RMS')}{times}",
        f"  length errors    {summary.texts['length_check']}",
        f"  datum            {summary.texts['datum']}",
        f"  left out         {summary.texts['rejected']}",
    ]
    return "\n".join(lines)
