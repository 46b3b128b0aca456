"""A plan for the report: what the measurement will be worth, what limits it, what would better it, and where."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from deflectometry.planning.pipeline.alternatives import ALTERNATIVES_FILE
from deflectometry.planning.pipeline.plan import FACETS_FILE, LIMITS_FILE, MAP_FILE, sigma_key
from deflectometry.planning.prospect import LIMITED
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, join, table_under_name
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, read_summary, read_table_csv, unit_of
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.tables import TableColumn, TableView

_MRAD = 1e3
#: Numbers of a plan: key and label.
_NUMBERS = (
    ("sigma_slope_x_rms_rad", "Slopes in x: sigma, RMS"),
    ("sigma_slope_y_rms_rad", "Slopes in y: sigma, RMS"),
    ("sigma_canting_rms_rad", "Canting: sigma, RMS of all facets"),
    ("sigma_mean_normal_rms_rad", "Mean normal: sigma, RMS of both axes"),
    ("sigma_focal_length_x_m", "Focal length in x: sigma"),
    ("sigma_focal_length_y_m", "Focal length in y: sigma"),
    ("seen_share", "Share of the mirror that sees the pattern"),
    ("sample_spacing_m", "Distance of samples on the mirror"),
)
_TEXTS = ("limits", "best", "mean normal", "resolution", "noise", "pattern", "target")


def first(folder: Path) -> FirstScreen:
    """Return what the measurement will be worth."""
    summary = read_summary(folder / SUMMARY_FILE)
    rows = []
    for key, label in _NUMBERS:
        value = summary.numbers.get(key)
        if value is not None:
            name, unit = unit_of(key)
            rows.append((label, number_text(float(value), None, unit, name), ""))
    line = f"{summary.kind}; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict_of(summary), rows, None)


def words(folder: Path) -> Html:
    """Return what is said of limits, alternatives, mean normal and resolution."""
    texts = read_summary(folder / SUMMARY_FILE).texts
    known = [name for name in _TEXTS if name in texts]
    return table_under_name(
        TableView("In words", (TableColumn("about", known), TableColumn("what", [texts[name] for name in known])))
    )


def alternatives(folder: Path) -> Html:
    """Return what each alternative betters, the best first; then missing sigmas; then what is impossible."""
    return alternative_tables(folder, {name: LIMITED[name] for name in _limited(folder)}, {"seen_share": "mirror seen"})


def alternative_tables(folder: Path, labels: Mapping[str, str], shares: Mapping[str, str]) -> Html:
    """Return the tables of the alternatives of any plan.

    labels, shares: Words of each sigma and of each share that an alternative may change.
    """
    table = read_table_csv(folder / ALTERNATIVES_FILE, ("change", *shares, "reason"))
    rows = range(1, len(table["change"]))
    done = [n for n in rows if not table["reason"][n]]
    # Folders written before there were such changes have no column of them.
    stated = [n for n in done if "states_sigma" in table and table["states_sigma"][n]]
    others = [n for n in done if n not in stated]
    parts = [_gains("What would better it: by how much each sigma is smaller", table, others, labels, shares)]
    if stated:
        title = "Sigmas that nobody states, stated: by how much each sigma is smaller; below 1 it is larger, and true"
        parts.append(_gains(title, table, stated, labels, shares))
    if impossible := [n for n in rows if n not in done]:
        said = (
            TableColumn("what is done otherwise", [table["change"][n] for n in impossible]),
            TableColumn("why not", [table["reason"][n] for n in impossible]),
        )
        parts.append(table_under_name(TableView("What is not possible", said)))
    return join(*parts)


def _gains(
    title: str,
    table: Mapping[str, Sequence[str]],
    done: Sequence[int],
    labels: Mapping[str, str],
    shares: Mapping[str, str],
) -> Html:
    columns = [TableColumn("what is done otherwise", [table["change"][n] for n in done])]
    for name, words in labels.items():
        gains = [float(table[f"gain_{name}"][n] or "nan") for n in done]
        columns.append(TableColumn(words, [f"{one:.2f}" if np.isfinite(one) else "\u2013" for one in gains], gains))
    for name, words in shares.items():
        seen = [float(table[name][n]) for n in done]
        columns.append(TableColumn(words, [f"{one:.1%}" for one in seen], seen))
    return table_under_name(TableView(title, tuple(columns)))


def limits(folder: Path) -> Html:
    """Return the share of each source of errors in each variance."""
    names = _limited(folder)
    table = read_table_csv(folder / LIMITS_FILE, ("source",))
    columns = [TableColumn("source of errors", table["source"])]
    for name in names:
        shares = [float(one) for one in table[f"share_of_{name}"]]
        columns.append(TableColumn(LIMITED[name], [f"{one:.0%}" for one in shares], shares))
    return table_under_name(TableView("What limits it: shares of the variance", tuple(columns)))


def facets(folder: Path) -> Html:
    """Return each facet's canting and the share that sees the pattern; of a single facet its hole, if any."""
    table = read_table_csv(folder / FACETS_FILE, ("facet", "seen_share", "hole"))
    if len(table["facet"]) == 1 and not table["hole"][0]:
        return Html("")
    seen = [float(one) for one in table["seen_share"]]
    columns = [TableColumn("facet", table["facet"]), TableColumn("seen", [f"{one:.1%}" for one in seen], seen)]
    if len(table["facet"]) > 1:
        for axis in "xy":
            sigmas = [_MRAD * float(one or "nan") for one in table[f"sigma_canting_{axis}_rad"]]
            columns.append(TableColumn(f"sigma of canting in {axis} [mrad]", [_short(one) for one in sigmas], sigmas))
    if any(table["hole"]):
        columns.append(TableColumn("where it looks past the screen", table["hole"]))
    return table_under_name(TableView("Facets", tuple(columns)))


def map_view(folder: Path) -> MapView:
    """Return the expected sigmas over the mirror."""
    slope_map = read_slope_map(folder / MAP_FILE)
    layers = []
    for axis, total, random in zip(
        "xy", slope_map.sigma_slope(), (slope_map.sigma_random_x, slope_map.sigma_random_y), strict=True
    ):
        for key, name, values in (("sigma", "Sigma of the slope", total), ("noise", "Noise alone", random)):
            shown = np.where(slope_map.valid, values, np.nan)
            layer = MapLayer(f"{key}_{axis}", f"{name} in {axis}", "mrad", shown, _MRAD, diverging=False, low=0.0)
            layers.append(layer)
    return MapView(
        name="Expected sigma over the mirror",
        x_m=slope_map.x_m,
        y_m=slope_map.y_m,
        layers=tuple(layers),
        flags=slope_map.flags,
        aperture=slope_map.aperture,
        note="Parts without colour will not be measured; the flag says why.",
    )


def _limited(folder: Path) -> Sequence[str]:
    numbers = read_summary(folder / SUMMARY_FILE).numbers
    return [name for name in LIMITED if sigma_key(name) in numbers]


def _short(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "\u2013"
