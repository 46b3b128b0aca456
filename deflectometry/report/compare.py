"""Sections of the report on two results of one mirror; each is a cell of its notebook."""

from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from deflectometry.comparison.pipeline.result import (
    CANTINGS_FILE,
    CHECKS_FILE,
    DIFFERENCE,
    FIRST,
    MAPS_FILE,
    REST,
    SECOND,
    TERMS_FILE,
)
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, join, table
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.slopes.map import SlopeMap
from heliogauge.view.maps import MapView, slope_map_view

Columns = dict[str, list[str]]


@dataclass(frozen=True, slots=True, eq=False)
class CompareResults:
    """What a folder with two compared results holds."""

    summary: Summary
    maps: dict[str, SlopeMap]
    terms: Columns
    checks: Columns
    cantings: Columns


def open_comparison(folder: str | Path = ".") -> CompareResults:
    """Read a folder with two compared results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    return CompareResults(
        read_summary(folder),
        {name: read_slope_map(folder / MAPS_FILE, name) for name in (FIRST, SECOND, DIFFERENCE, REST)},
        read_table_csv(folder / TERMS_FILE, ("term", "difference", "sigma_difference")),
        read_table_csv(folder / CHECKS_FILE, ("result",)),
        read_table_csv(folder / CANTINGS_FILE, ("facet",)) if (folder / CANTINGS_FILE).is_file() else {},
    )


def head(results: CompareResults) -> FirstScreen:
    """Return the first screen: verdict, numbers, the difference."""
    numbers, texts = results.summary.numbers, results.summary.texts
    rows: list[tuple[str, ...]] = []
    for axis in "xy":
        key, expected = f"rest_{axis}_rms_rad", numbers.get(f"rest_{axis}_expected_rms_rad")
        if (value := numbers.get(f"difference_{axis}_rms_rad")) is not None:
            rows.append((f"Difference of slopes in {axis}, RMS", number_text(value, None, "rad")))
        if (value := numbers.get(key)) is not None and expected is not None:
            note = f"the sigmas make {number_text(expected, None, 'rad')}"
            rows.append((f"the same beside linear terms, in {axis}", number_text(value, None, "rad"), note))
    line = f"{texts['first']} minus {texts['second']}; heliogauge {results.summary.version}"
    verdict = verdict_of(results.summary)
    return page.first_screen(results.summary.name, line, verdict, rows, _view(results, DIFFERENCE))


def verdict(results: CompareResults) -> Html:
    """Return the verdict in words, and how the second map was placed."""
    texts = results.summary.texts
    items = "".join(f"<li>{escape(part)}</li>" for part in (*texts["verdict"].split("; "), texts["placed"]))
    return Html(f"<ul>{items}</ul>")


def doubts(results: CompareResults) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results)


def terms(results: CompareResults) -> Html:
    """Return the linear terms of both maps and of the difference."""
    columns, rows = results.terms, []
    for k, name in enumerate(columns["term"]):
        unit = columns["unit"][k]
        cells = [_text(columns[key][k], columns[f"sigma_{key}"][k], unit) for key in ("first", "second", "difference")]
        stated = _text(columns["sigma_difference_as_stated"][k], "", unit)
        rows.append((name.replace("_", " "), *cells, stated, columns["contradicts"][k]))
    first, second = (results.summary.texts[key] for key in ("first", "second"))
    shown = table(
        ("term", first, second, "difference \u00b1 1 sigma", "sigma as stated", "contradicts"),
        rows,
        numbers=(1, 2, 3, 4),
    )
    note = (
        "Sigma as stated: without what was added because the data of a result contradict themselves. Curvature is "
        "1/(2 f). Shear is half of the curl, which no surface has. Tilts belong to the frame of each instrument "
        "and are not judged."
    )
    return join(shown, Html(f'<p class="caption">{note}</p>'))


def canting(results: CompareResults) -> Html:
    """Return the canting of single facets in both results."""
    columns = results.cantings
    if not columns:
        return Html('<p class="caption">Not compared: both results need two measured facets of the same names.</p>')
    rows = [
        (
            name,
            *(_text(columns[f"{side}_{axis}_rad"][k], "", "rad") for side in ("first", "second") for axis in "xy"),
            *(_text(columns[f"difference_{axis}_rad"][k], columns[f"sigma_{axis}_rad"][k], "rad") for axis in "xy"),
        )
        for k, name in enumerate(columns["facet"])
    ]
    first, second = (results.summary.texts[key] for key in ("first", "second"))
    titles = ("facet", f"{first}, x", "y", f"{second}, x", "y", "difference in x \u00b1 1 sigma", "in y")
    note = "Each without the mean of all facets, which belongs to the frame of each instrument."
    return join(table(titles, rows, numbers=tuple(range(1, 7))), Html(f'<p class="caption">{note}</p>'))


def own_data(results: CompareResults) -> Html:
    """Return what the data of each result say of it."""
    columns, rows = results.checks, []
    for k, name in enumerate(columns["result"]):
        rows.append(
            (
                name,
                _text(columns["curl_per_m"][k], columns["sigma_curl_per_m"][k], "1/m"),
                _text(columns["smooth_curl_per_m"][k], "", "1/m"),
                _text(columns["smooth_curl_ratio"][k], "", ""),
                _text(columns["turn_rad"][k], "", "rad"),
                columns["serious_doubts"][k] or "none",
            )
        )
    return table(
        (
            "result",
            "mean curl",
            "smooth curl, RMS",
            "over what its sigmas make",
            "reflection against outline",
            "serious doubts",
        ),
        rows,
        numbers=(1, 2, 3, 4),
    )


def _text(value: str, sigma: str, unit: str) -> str:
    number = float(value) if value else float("nan")
    if not np.isfinite(number):
        return "-"
    spread = float(sigma) if sigma else None
    if unit == "1/m":
        return number_text(1e3 * number, None if spread is None else 1e3 * spread, "mrad/m")
    return number_text(number, spread, unit)


def maps(results: CompareResults) -> Html:
    """Return the maps of both results, and the difference without its linear terms."""
    return join(*(_view(results, name) for name in (FIRST, SECOND, REST)))


def _view(results: CompareResults, name: str) -> MapView:
    titles = {
        FIRST: results.summary.texts["first"],
        SECOND: f"{results.summary.texts['second']}, placed in the frame of the first",
        DIFFERENCE: "First minus second",
        REST: "First minus second, without linear terms",
    }
    return slope_map_view(results.maps[name], titles[name])


def inputs(results: CompareResults) -> Html:
    """Return the input files."""
    return page.input_table(results)
