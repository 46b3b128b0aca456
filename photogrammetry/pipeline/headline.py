"""The lines of a result on the terminal."""

from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary


def headline_text(summary: Summary) -> str:
    """Say the most important numbers in a few lines for the terminal."""
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
    return "\n".join([*lines, *_surface_lines(summary)])


def _surface_lines(summary: Summary) -> list[str]:
    """Say what there is of a surface, each number with its sigma."""

    def said(key: str, unit: str, sigma: str = "") -> str:
        value, spread = summary.numbers[key], summary.numbers.get(sigma)
        known = None if value is None else number_text(float(value), None if spread is None else float(spread), unit)
        return known or summary.not_determined[key]

    numbers, lines = summary.numbers, []
    if "deviation_rms_m" in numbers:
        lines.append(
            f"  surface          {summary.texts['surface']}; deviation RMS "
            f"{said('deviation_rms_m', 'm', 'sigma_deviation_rms_m')}, "
            f"{numbers['surface_outliers_count']} points not used"
        )
    for key in (one for one in numbers if one.startswith("best_fit_")):
        name = key.removeprefix("best_fit_").removesuffix("_m").replace("_", " ")
        lines.append(f"  best fit         {name} {said(key, 'm', f'sigma_{key}')}")
    if "sdx_rad" in numbers:
        lines.append(
            f"  slope deviation  SDx {said('sdx_rad', 'rad', 'sigma_sdx_rad')}, "
            f"SDy {said('sdy_rad', 'rad', 'sigma_sdy_rad')} of the normal"
        )
    if "facets_count" in numbers:
        lines.append(
            f"  canting          {numbers['facets_count']} facets, RMS x {said('canting_rms_x_rad', 'rad')}, "
            f"y {said('canting_rms_y_rad', 'rad')} of the normal"
        )
    if "moved_count" in numbers:
        lines.append(f"  other date       {numbers['moved_count']} of {numbers['compared_count']} targets moved")
    return lines
