"""Parts of the reports on one heliostat and on a field, from the files of their results."""

import base64
import html
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.heliostat.report import figures_residuals as figures
from calibration.heliostat.report.results import FieldReport, HeliostatReport
from heliogauge.files.regular import read_regular
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.notation import number_text

_MOST_ROWS = 60
#: Letters of a reason in the table of a field.
_REASON_LENGTH = 160
#: Headline of one heliostat: words and keys of an angle summary.
_ANGLES = (
    ("beam, RMS", "beam_rms_mrad"),
    ("beam, median", "beam_median_mrad"),
    ("beam, largest", "beam_max_mrad"),
    ("normal, RMS", "normal_rms_mrad"),
    ("normal, median", "normal_median_mrad"),
)
#: Parameters are shown in these units: factor and name for the stored one.
_SHOWN_UNITS = {"rad": (1e3, "mrad"), "m": (1.0, "m"), "1/m": (1.0, "1/m"), "1": (1.0, "")}


def title(report: HeliostatReport) -> Html:
    """Return the head of the report: heliostat, model, number of observations, version."""
    content, summary = report.content, report.summary
    counts = content["observations"]
    line = (
        f"calibration of a heliostat; {counts['used']} of {counts['n']} observations used; model "
        f"{content['model']['kind']}, {content['model']['name']}; heliogauge {summary.version}"
    )
    return page.name_and_line(str(content["heliostat"]), line)


def headline(report: HeliostatReport) -> Html:
    """Return what the model does to observations it was fitted to and to those it was not."""
    content = report.content
    name = content["split"]
    split = content["splits"].get(name)
    if split is None:
        reason = content["splits_not_made"].get(name, "the observations give none")
        lead = Html(f"<p>No observations could be held out ({html.escape(str(reason))}).</p>")
        columns: dict[str, Mapping[str, Any]] = {}
    else:
        words = [f"Held out: the {html.escape(str(name))} split."]
        words += [f"{html.escape(one['text'])}." for one in split["doubts"]]
        lead = Html(f"<p>{' '.join(words)}</p>")
        test, train = split["test"], split["train"]
        columns = {f"predicted ({test['n']})": test, f"fitted ({train['n']})": train}
    whole = content["fit_to_all"]
    columns[f"fit to all ({whole['n']})"] = whole
    rows = [(word, *(_milli(column.get(key)) for column in columns.values())) for word, key in _ANGLES]
    numbers = table(("", *columns), rows, numbers=range(1, 1 + len(columns)))
    return join(lead, Html(f'<div class="headline">{numbers.text}</div>'))


def split_table(report: HeliostatReport) -> Html:
    """Return every split with the error to expect, and what was found."""
    rows = []
    for name, split in report.content["splits"].items():
        train, test = split["train"], split["test"]
        angles = (
            split["predicted_sigma_median_mrad"],
            test["beam_rms_mrad"],
            train["beam_rms_mrad"],
            test["normal_rms_mrad"],
            train["normal_rms_mrad"],
        )
        rows.append((name, f"{split['extrapolated_count']} of {test['n']}", *map(_number, angles), split["note"]))
    rows += [(name, *([""] * 6), f"not made: {why}") for name, why in report.content["splits_not_made"].items()]
    head = ("split", "extrapolated", "expected", "beam predicted", "fitted", "normal predicted", "fitted", "")
    note = (
        "All angles in mrad, RMS; expected: 1 sigma of the beam, predicted before looking at the test positions. "
        "Extrapolated: test positions beyond those of training."
    )
    return join(table(head, rows, numbers=range(1, 7)), _caption(note))


def residual_figures(report: HeliostatReport) -> Html:
    """Return residuals on the targets and against time and sun."""
    on_targets = [figures.target_figure(report, name) for name in figures.targets_hit(report)]
    return show(*on_targets, *figures.series_figures(report).values())


def beam_section(report: HeliostatReport) -> Html:
    """Return the pictures of the most informative beams in photos; nothing where there are none."""
    files = sorted(report.folder.glob("beam_*.png"))
    if not files:
        return Html("")
    data = [base64.b64encode(read_regular(file)).decode("ascii") for file in files]
    images = [
        f'<figure><img alt="{file.stem}" src="data:image/png;base64,{text}"></figure>'
        for file, text in zip(files, data, strict=True)
    ]
    order = "Photos that were left out come first, then the largest residuals, then those around the median; "
    note = _caption(f"{order}beams.csv has all.")
    return join(Html(f'<h3>Beams in the photos</h3><div class="figures">{"".join(images)}</div>'), note)


def sky_section(report: HeliostatReport) -> Html:
    """Return the map of the predicted uncertainty."""
    if not report.content.get("sky"):
        return Html("<p>Not made for fields of many heliostats; <code>--thorough</code> makes it.</p>")
    caption = "Includes what the residuals show beyond the noise of the observations."
    return show(figures.sky_figure(report), caption=caption)


def parameter_table(report: HeliostatReport) -> Html:
    """Return the parameters that are not held, with sigma and prior."""
    rows = []
    for name, one in report.content["parameters"].items():
        if one["state"] == "held":
            continue
        factor, unit = _SHOWN_UNITS.get(one["unit"], (1.0, one["unit"]))
        sigma = one["sigma"]
        moved = "" if not one["prior_sigma"] else f"{(one['value'] - one['nominal']) / one['prior_sigma']:+.1f}"
        prior = "free" if one["prior_sigma"] is None else f"± {factor * one['prior_sigma']:.3g}"
        # Without its unit, so that all of a row are in the same one (number_text goes to mm where a value is small).
        value = f"{number_text(factor * one['value'], None if sigma is None else factor * sigma, '')} {unit}".rstrip()
        rows.append((name.replace("_", " "), value, f"{factor * one['nominal']:.6g}", prior, moved))
    if not rows:
        return Html("<p>All parameters are held.</p>")
    head = ("parameter", "value ± 1 sigma", "known before", "prior", "moved by, in prior sigmas")
    return table(head, rows, numbers=(1, 2, 3, 4))


def model_section(report: HeliostatReport) -> Html:
    """Return parameters, how they were chosen, their correlations and what nothing observes."""
    content = report.content
    model = content["model"]
    parts = [parameter_table(report)]
    held = [one["text"] for one in content["unobservable"]]
    words = f"Rank {content['rank']} of {content['n_free']} parameters."
    if held:
        words += " Not observed, held by what is known beforehand: " + "; ".join(map(html.escape, held)) + "."
    parts.append(Html(f"<p>{words}</p>"))
    if model.get("candidates"):
        rows = [
            (one["name"], str(one["n_free"]), _milli(one["blocked_rms_mrad"]), _milli(one["fit_rms_mrad"]))
            for one in model["candidates"]
        ]
        head = ("choice of parameters", "parameters", "beam predicted to suns left aside", "beam fitted")
        parts += [
            Html(f"<p>{html.escape(model['name'])}: {html.escape(str(model['chosen_because']))}.</p>"),
            table(head, rows, numbers=(1, 2, 3)),
        ]
    if len(content["correlation"]["names"]) > 1:
        parts.append(show(figures.correlation_figure(content["correlation"])))
    return join(*parts)


def finding_section(report: HeliostatReport) -> Html:
    """Return what the diagnosis found."""
    diagnosis = report.content.get("diagnosis")
    if diagnosis is None:
        return Html("<p>Not made.</p>")
    findings, looks = diagnosis["findings"], len(diagnosis["checks"])
    if not findings:
        text = f"Nothing found in {looks} kinds of check: the heliostat behaves as its model."
        return Html(f'<div class="fine">{text}</div>')
    rows = [(f"{one['kind'].replace('_', ' ')} ({one['severity']})", one["text"], one["remedy"]) for one in findings]
    return table(("kind", "evidence", "what to do"), rows)


def unused_section(report: HeliostatReport) -> Html:
    """Return the observations that were left out, with the reason."""
    rows = report.residuals
    left_out = [i for i in range(len(rows)) if rows.flag[i]]
    if not left_out:
        return Html("<p>All observations were used.</p>")
    beam = rows.numbers["residual_beam_mrad"]
    cells = [
        (
            rows.observation[i],
            "" if np.isnat(rows.time[i]) else f"{str(rows.time[i])[:16]}Z",
            rows.target[i],
            rows.flag[i],
            rows.reason[i],
            _milli(beam[i]),
        )
        for i in left_out[:_MOST_ROWS]
    ]
    head = ("observation", "time", "target", "flag", "reason", "residual of the beam")
    more = len(left_out) - _MOST_ROWS
    note = _caption(f"{more} more in residuals.csv." if more > 0 else "")
    return join(table(head, cells, numbers=(5,)), note)


def note_section(report: HeliostatReport) -> Html:
    """Return how the numbers came about."""
    content = report.content
    notes = [str(note["text"]) for note in content["notes"]]
    notes += [
        f"sigmas of {kind} observations: {factor:.3g} times the stated ones"
        for kind, factor in content["sigma_factor"].items()
    ]
    if content.get("sun_check_median_mrad") is not None:
        check = content["sun_check_median_mrad"]
        notes.append(f"recorded positions of the sun differ from the computed ones by {check:.3g} mrad (median)")
    items = "".join(f"<li>{html.escape(note)}</li>" for note in dict.fromkeys(notes))
    return Html(f"<ul>{items}</ul>")


# --- the field --------------------------------------------------------------------------------------------------------


def field_title(report: FieldReport) -> Html:
    """Return the head of a field's report."""
    numbers, summary = report.summary.numbers, report.summary
    line = (
        f"calibration of heliostats; {numbers['calibrated_count']} of {numbers['heliostats_count']} calibrated; "
        f"{summary.texts.get('split', '')} split; heliogauge {summary.version}"
    )
    return page.name_and_line(summary.name, line)


def field_doubts(report: FieldReport) -> Html:
    """Return how many heliostats failed or need a second look, or the statement that none does."""
    numbers = report.summary.numbers
    failed, faulty, doubtful = (int(numbers.get(f"{kind}_count") or 0) for kind in ("failed", "faulty", "doubtful"))
    doubts = [html.escape(one.text) for one in report.summary.doubts]
    if not (failed or faulty or doubtful or doubts):
        return Html('<div class="fine">No warnings: every check of every heliostat passed.</div>')
    count = numbers["heliostats_count"]
    first = (
        f"{failed} of {count} heliostats have no model; {faulty} have a fault; {doubtful} have warnings of their own"
    )
    items = "".join(f"<li>{text}</li>" for text in (first, *doubts))
    return Html(f'<div class="warnings"><strong>to look at</strong><ul>{items}</ul></div>')


def field_headline(report: FieldReport) -> Html:
    """Return the numbers of the field."""
    beam, normal = report.numbers("beam_test_rms_mrad"), report.numbers("normal_test_rms_mrad")
    known = np.isfinite(beam)
    numbers = report.summary.numbers
    counts = ", ".join(
        str(numbers.get(f"{kind}_count") or 0) for kind in ("calibrated", "faulty", "doubtful", "failed")
    )
    rows = [("Heliostats: calibrated, of these with a fault, with doubts; failed", counts)]
    for word, values in (("Beam", beam), ("Normal", normal)):
        if np.isfinite(values).any():
            low, middle, high = np.nanpercentile(values, [5, 50, 95])
            text = f"{middle:.2f} mrad (5 % below {low:.2f}, 95 % below {high:.2f})"
            rows.append((f"{word}, RMS on predicted positions, median heliostat", text))
    if known.any() and np.isfinite(normal).any():
        share = 100 * np.mean(normal[np.isfinite(normal)] <= 1.0)
        rows.append(("Normal within 1 mrad RMS", f"{share:.0f} % of the heliostats"))
    return Html(f'<div class="headline">{table(("", ""), rows, numbers=(1,)).text}</div>')


def field_figures(report: FieldReport) -> Html:
    """Return map and distribution of the errors."""
    beam, normal = report.numbers("beam_test_rms_mrad"), report.numbers("normal_test_rms_mrad")
    east, north = report.numbers("e_m"), report.numbers("n_m")
    return show(figures.field_map_figure(east, north, beam), figures.field_histogram_figure(beam, normal))


def field_table(report: FieldReport) -> Html:
    """Return the worst heliostats, the worst first."""
    rows, count = report.rows, len(report.rows["heliostat"])
    shown = ("beam_test_rms_mrad", "beam_train_rms_mrad", "predicted_sigma_beam_mrad", "normal_test_rms_mrad")
    angles = {name: report.numbers(name) for name in shown}
    found = rows.get("diagnosis", ("",) * count)
    states = [kind.replace("_", " ") or status for kind, status in zip(found, rows["status"], strict=True)]
    cells = [
        (
            rows["heliostat"][i],
            states[i],
            rows["model"][i],
            *(_number(angles[name][i]) for name in shown),
            f"{rows['used_count'][i]}/{rows['observations_count'][i]}" if rows["used_count"][i] else "",
            _shortened(rows["reason"][i]),
        )
        for i in range(min(count, _MOST_ROWS))
    ]
    head = ("heliostat", "", "model", "beam predicted", "fitted", "expected", "normal predicted", "used", "")
    more = f"The worst {_MOST_ROWS} of {count}; all are in field.csv. " if count > _MOST_ROWS else ""
    command = "<code>heliogauge report OUT/NAME</code> makes the report of one heliostat."
    note = f"{more}Angles in mrad, RMS; reasons in full in field.csv. {command}"
    return join(table(head, cells, numbers=(3, 4, 5, 6)), _caption(note))


def _caption(text: str) -> Html:
    return Html(f'<p class="caption">{text}</p>' if text else "")


def _shortened(text: str) -> str:
    return text if len(text) <= _REASON_LENGTH else f"{text[:_REASON_LENGTH].rsplit(' ', 1)[0]} ..."


def _number(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.2f}"


def _milli(value: float | None) -> str:
    text = _number(value)
    return f"{text} mrad" if text else ""
