"""Sections of a trough's report; each is one cell of the notebook and returns what it shows."""

import html
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, join, table
from heliogauge.reporting.notation import height_text, light_text, number_text, turn_text
from heliogauge.reporting.verdict import Verdict, holes, verdict_of
from heliogauge.results.folder import Summary, unit_of
from heliogauge.validate import BoolArray
from heliogauge.view.tables import TableColumn, TableView
from observer.doubts.halves import halves_words
from observer.photo_edges.tube_bearings import beside_support
from observer.product.panel_turns import LEAST_GAIN_SHARE, is_worth
from observer.report.lines import absorber, intercept, panels, residuals
from observer.report.maps import maps, mirror_view, spread
from observer.report.pictures import photos, slices
from observer.report.results import Columns, TroughResults, numbers, open_trough
from observer.report.scene import network
from observer.trough.collector import Collector

__all__ = [
    "absorber",
    "doubts",
    "head",
    "headline_rows",
    "in_words",
    "inputs",
    "intercept",
    "making",
    "maps",
    "network",
    "not_used",
    "numbers_table",
    "open_trough",
    "overview",
    "panels",
    "photos",
    "refused",
    "residuals",
    "slices",
    "spread",
    "stations_missing",
]

#: Numbers of the first screen and what they are called there; the others are folded away below.
LABELS: dict[str, str] = {
    "sdx_rad": "SDx, RMS angle of the normal across the trough",
    "sdx_tilt_removed_rad": "SDx without the mean tilt",
    "rms_theta_ra_rad": "theta_ra RMS, mirror and absorber",
    "median_sigma_theta_r_rad": "sigma of theta_r at a point (median)",
    "measured_share": "Share of the mirror measured",
    "seeable_measured_share": "Share measured of what can show the tube",
    "absorber_mean_x_m": "Absorber, mean X_a",
    "absorber_mean_z_offset_m": "Absorber, mean Z_a",
    "absorber_sag_down_m": "Absorber, largest sag downward",
    "intercept_ratio": "Intercept factor",
    "intercept_absorber_aligned_ratio": "with the absorber aligned",
}


#: Panels that the first screen names.
_MOST_PANELS = 6


class HasTables(Protocol):
    """Results with tables of a collector."""

    @property
    def collector(self) -> Collector:
        """The design."""
        ...

    def table(self, name: str) -> Columns | None:
        """Return a table as text; None where there is none."""
        ...


def head(results: TroughResults) -> FirstScreen:
    """Return the first screen: verdict, headline numbers, the mirror."""
    summary, slope_map = results.base.summary, results.base.slope_map
    line = f"trough, observer; design: {slope_map.design}; heliogauge {summary.version}"
    light = {"intercept_ratio": summary.texts.get("light", "")}
    rows = [*headline_rows(summary, LABELS, light), *panels_to_turn(results)]
    return page.first_screen(summary.name, line, _verdict(results), rows, mirror_view(results))


def _verdict(results: TroughResults) -> Verdict:
    summary = results.base.summary
    counts = summary.numbers
    passed = []
    if counts.get("edges_used_count") and counts.get("edges_rejected_count") is not None:
        used, refused_ = int(counts["edges_used_count"] or 0), int(counts["edges_rejected_count"] or 0)
        passed.append(f"{used} edges of the reflection used, {100 * refused_ / (used + refused_):.1f} % refused")
    if counts.get("image_residual_rms_px"):
        residual = float(counts["image_residual_rms_px"] or 0.0)
        passed.append(f"{len(results.photos)} photos adjusted, targets within {residual:.2g} px RMS")
    return verdict_of(summary, (*holes(results.base.slope_map), *stations_missing(results)), passed)


def panels_to_turn(results: TroughResults) -> list[tuple[str, ...]]:
    """Say which panels gain by a turn, and how much, as `page.headline_numbers` takes it."""
    columns = results.table("panels.csv")
    if columns is None or "gain_is_sure" not in columns:
        return []
    sure = numbers(columns, "gain_is_sure") == 1
    if not sure.any():
        return [("Panels that surely gain by a turn", f"none of {sure.size}")]
    gain = numbers(columns, "gain_ratio")
    best = np.flatnonzero(sure)[np.argsort(-gain[sure])]
    turns, sigmas = -numbers(columns, "mean_theta_ra_rad"), numbers(columns, "sigma_mean_theta_ra_rad")
    named = ", ".join(f"{columns['panel'][one]} by {turn_text(turns[one], sigmas[one])}" for one in best[:_MOST_PANELS])
    more = f" and {best.size - _MOST_PANELS} more" if best.size > _MOST_PANELS else ""
    counts, key = results.base.summary.numbers, "intercept_gain_panels_turned_ratio"
    gained = light_text(float(counts[key] or 0.0), float(counts[f"sigma_{key}"] or 0.0))
    label = f"Gain by turning {best.size} of {sure.size} panels"
    return [(label, gained, f"{_worth_text(is_worth(gain)[best])}: panel {named}{more}; see Panels below")]


def _worth_text(worth: BoolArray) -> str:
    """Say which of the panels that surely gain, the largest gain first, are worth a turn."""
    least = f"{100 * LEAST_GAIN_SHARE:g} % of the panel's own light"
    if not worth.any():
        return f"no panel is worth a turn, each gains less than {least}"
    if worth.all():
        return "each worth a turn"
    first = "the first" if worth.sum() == 1 else f"the first {int(worth.sum())}"
    return f"{first} worth a turn, the others below {least}"


def stations_missing(results: HasTables) -> tuple[str, ...]:
    """Say how many stations of the absorber have no value, as `verdict_of` takes it.

    Stations that a stated support hides do not count: no photo can show them.
    """
    columns = results.table("absorber.csv")
    if not columns:
        return ("the absorber is not measured",)
    places = numbers(columns, "x_a_m")
    design = results.collector
    hidden = beside_support(numbers(columns, "y_m"), np.asarray(design.support_y_m), design.support_width_m)
    missing = int((~np.isfinite(places) & ~hidden).sum())
    return (
        (f"{missing} of {int((np.isfinite(places) | ~hidden).sum())} stations of the absorber not measured",)
        if missing
        else ()
    )


def doubts(results: TroughResults) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results.base)


def overview(results: TroughResults) -> Html:
    """Return the result in words, further numbers and what they refer to."""
    return join(in_words(results.base.summary), numbers_table(results.base.summary), page.text_table(results.base))


def in_words(summary: Summary) -> Html:
    """Say in sentences what was found."""

    def said(key: str) -> str:
        return _text(summary, key)

    sentences = [
        f"Across the trough the mirror's normals depart from the design's by {said('sdx_rad')} RMS, "
        f"{said('sdx_tilt_removed_rad')} without a mean tilt; this angle, theta_r, is known at one point to "
        f"{said('median_sigma_theta_r_rad')}. {said('measured_share')} of the mirror could be measured.",
        f"On average the absorber is {said('absorber_mean_x_m')} beside the plane of symmetry (+ towards +x) and "
        f"{said('absorber_mean_z_offset_m')}.",
        f"Mirror and absorber together, which is what the sun meets, are theta_ra, {said('rms_theta_ra_rad')} RMS, at "
        f"one point known to {said('median_sigma_theta_ra_rad')}.",
    ]
    if "intercept_ratio" in summary.numbers:
        text = f"The intercept factor is {said('intercept_ratio')}"
        if "intercept_absorber_aligned_ratio" in summary.numbers:
            text += f"; with the absorber aligned it would be {said('intercept_absorber_aligned_ratio')}"
        sentences.append(text + ".")
    sentences += [f"{text[0].upper()}{text[1:]}." for text in halves_words(summary.numbers)]
    return Html(f"<p>{html.escape(' '.join(sentences))}</p>")


def headline_rows(
    summary: Summary, labels: Mapping[str, str], notes: Mapping[str, str] | None = None
) -> list[tuple[str, ...]]:
    """Return the headline numbers as `page.headline_numbers` takes them.

    labels: Keys of the numbers, and what they are called there.
    notes: What stands below some labels, by the same keys.
    """
    rows: list[tuple[str, ...]] = []
    for key, label in labels.items():
        if key not in summary.numbers:
            continue
        reason = summary.not_determined.get(key, "")
        rows.append(
            (label, "not determined", reason)
            if summary.numbers[key] is None
            else (label, _text(summary, key), (notes or {}).get(key, ""))
        )
    return rows


def numbers_table(summary: Summary) -> Html:
    """Return all numbers of a result, folded away."""
    keys = [
        key
        for key in summary.numbers
        if not (key.startswith("sigma_") and key.removeprefix("sigma_") in summary.numbers)
    ]
    rows = [(unit_of(key)[0].replace("_", " "), _text(summary, key)) for key in keys]
    values = table(("", "value \u00b1 1 sigma"), rows, numbers=(1,))
    return Html(f"<details><summary>all {len(rows)} numbers</summary>{values.text}</details>")


def _text(summary: Summary, key: str) -> str:
    value = summary.numbers.get(key)
    if value is None:
        return f"not determined: {summary.not_determined.get(key, '')}"
    sigma = summary.numbers.get(f"sigma_{key}")
    if key == "absorber_mean_z_offset_m":
        return height_text(value, None if sigma is None else float(sigma))
    return number_text(value, None if sigma is None else float(sigma), unit_of(key)[1], key)


def refused(results: TroughResults) -> Html:
    """Return nodes of the map without a value, and photos and targets that were not used, with reasons."""
    return join(page.flag_table(results.base.slope_map), not_used(results))


def not_used(results: HasTables) -> Html:
    """Return photos and targets that were not used, with reasons."""
    columns = results.table("rejected.csv") or {"name": [], "reason": []}
    if not columns["name"]:
        return Html("<p>All photos and targets were used.</p>")
    shown = (TableColumn("not used", columns["name"]), TableColumn("why", columns["reason"]))
    return join(TableView("photos and targets that were not used", shown))


def making(results: TroughResults) -> Html:
    """Return how long each stage took."""
    return page.duration_table(results.base)


def inputs(results: TroughResults) -> Html:
    """Return the files that were read."""
    return page.input_table(results.base)
