"""Sections of a trough's report; each is one cell of the notebook and returns what it shows."""

import html
from collections.abc import Mapping

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, table
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, unit_of
from observer.report.lines import absorber, intercept, panels, residuals
from observer.report.maps import maps
from observer.report.pictures import overlay, slices
from observer.report.results import TroughResults, open_trough
from observer.report.scene import network

__all__ = [
    "absorber",
    "head",
    "intercept",
    "making",
    "maps",
    "network",
    "open_trough",
    "overlay",
    "overview",
    "panels",
    "refused",
    "residuals",
    "slices",
]

#: Numbers of the headline table and what they are called there; the others are folded away.
LABELS: dict[str, str] = {
    "sdx_rad": "SDx, RMS angle of the normal from the design's across the trough",
    "sdx_tilt_removed_rad": "SDx without the mean tilt",
    "mean_theta_r_rad": "Mean of theta_r (tilt of the whole mirror, + towards +x)",
    "rms_theta_ra_rad": "RMS of theta_ra, mirror and absorber together",
    "median_sigma_theta_r_rad": "Uncertainty of theta_r at one point (median)",
    "median_sigma_theta_ra_rad": "Uncertainty of theta_ra at one point (median)",
    "measured_share": "Share of the mirror measured",
    "absorber_mean_x_m": "Absorber, mean X_a",
    "absorber_mean_z_offset_m": "Absorber, mean Z_a above the focal line",
    "absorber_range_x_m": "Absorber, range of X_a along the trough",
    "absorber_range_z_m": "Absorber, range of Z_a along the trough",
    "intercept_ratio": "Intercept factor",
    "intercept_absorber_aligned_ratio": "with the absorber aligned",
    "intercept_mirror_perfect_ratio": "with a perfect mirror",
    "photos_count": "Photos",
    "edges_used_count": "Edges of the reflection that were used",
}


def head(results: TroughResults) -> Html:
    """Return title and warnings."""
    return join(page.title(results.base), page.doubts_box(results.base))


def overview(results: TroughResults) -> Html:
    """Return the result in words, the headline numbers and what they refer to."""
    return join(in_words(results.base.summary), headline_table(results.base.summary), page.text_table(results.base))


def in_words(summary: Summary) -> Html:
    """Say in sentences what was found."""

    def said(key: str) -> str:
        return _text(summary, key)

    sentences = [
        f"Across the trough the mirror's normals depart from the design's by {said('sdx_rad')} RMS, "
        f"{said('sdx_tilt_removed_rad')} without a mean tilt; this angle, theta_r, is known at one point to "
        f"{said('median_sigma_theta_r_rad')}. {said('measured_share')} of the mirror could be measured.",
        f"On average the absorber is {said('absorber_mean_x_m')} beside the plane of symmetry (+ towards +x) and "
        f"{said('absorber_mean_z_offset_m')} above the focal line (+ away from the mirror).",
        f"Mirror and absorber together, which is what the sun meets, are theta_ra, {said('rms_theta_ra_rad')} RMS, at "
        f"one point known to {said('median_sigma_theta_ra_rad')}.",
    ]
    if "intercept_ratio" in summary.numbers:
        text = f"The intercept factor is {said('intercept_ratio')}"
        if "intercept_absorber_aligned_ratio" in summary.numbers:
            text += f"; with the absorber aligned it would be {said('intercept_absorber_aligned_ratio')}"
        sentences.append(text + ".")
    return Html(f"<p>{html.escape(' '.join(sentences))}</p>")


def headline_table(summary: Summary, labels: Mapping[str, str] = LABELS) -> Html:
    """Return the headline numbers, the less important ones folded away.

    Returns: A table, and another one that opens on a click.
    """
    numbers = summary.numbers
    keys = [key for key in numbers if not (key.startswith("sigma_") and key.removeprefix("sigma_") in numbers)]
    first = [(label, _text(summary, key)) for key, label in labels.items() if key in numbers]
    others = [(unit_of(key)[0].replace("_", " "), _text(summary, key)) for key in keys if key not in labels]
    values = table(("", "value \u00b1 1 sigma"), first, numbers=(1,))
    more = table(("", "value \u00b1 1 sigma"), others, numbers=(1,))
    folded = f"<details><summary>{len(others)} more numbers</summary>{more.text}</details>" if others else ""
    return Html(f'<div class="headline">{values.text}</div>{folded}')


def _text(summary: Summary, key: str) -> str:
    value = summary.numbers.get(key)
    if value is None:
        return f"not determined: {summary.not_determined.get(key, '')}"
    sigma = summary.numbers.get(f"sigma_{key}")
    return number_text(value, None if sigma is None else float(sigma), unit_of(key)[1], key)


def refused(results: TroughResults) -> Html:
    """Return nodes of the map without a value, and photos and targets that were not used, with reasons."""
    nodes = page.flag_table(results.base.slope_map)
    columns = results.table("rejected.csv") or {"name": [], "reason": []}
    rows = list(zip(columns["name"], columns["reason"], strict=True))
    items = table(("not used", "why"), rows) if rows else Html("<p>All photos and targets were used.</p>")
    return join(nodes, items)


def making(results: TroughResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results.base), page.input_table(results.base))
