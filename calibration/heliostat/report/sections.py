"""Parts of the reports on one heliostat and on a field, from the files of their results."""

import html
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.files.field_work import dates_text
from calibration.heliostat.files.store_heliostat import left_out_text
from calibration.heliostat.report import figures_residuals as figures
from calibration.heliostat.report.charts import (
    beam_view,
    distribution_view,
    field_view,
    first_view,
    pictured,
    series_views,
    sky_view,
    target_view,
)
from calibration.heliostat.report.results import FieldReport, HeliostatReport
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join, table
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import State, verdict_of
from heliogauge.view.stills import side_by_side
from heliogauge.view.tables import TableColumn, TableView

#: A larger share of observations that were not used is a hole.
_MOST_LEFT_OUT = 0.1
#: Letters of a sentence on what a heliostat needs, and how many of them the page of a field has.
_WORK_LENGTH, _MOST_SENTENCES = 320, 40
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


def first_screen(report: HeliostatReport) -> FirstScreen:
    """Return the first screen: verdict, what the model predicts, the residuals on the target."""
    content, summary = report.content, report.summary
    counts = content["observations"]
    name = content["split"]
    split = content["splits"].get(name)
    missing = [] if split else ["no observations held out: how well it predicts is not known"]
    left_out = counts["n"] - counts["used"]
    said = left_out_text(counts)
    passed = [f"{counts['used']} of {counts['n']} observations used{f'; {said}' if said else ''}"]
    if left_out > _MOST_LEFT_OUT * counts["n"]:
        missing.append(f"{left_out} of {counts['n']} observations not used ({said})")
        passed = []
    diagnosis = content.get("diagnosis")
    if diagnosis is None:
        missing.append("no diagnosis was made")
    elif not any(one["severity"] == "fault" for one in diagnosis["findings"]):
        passed.append(f"no fault found in {len(diagnosis['checks'])} checks")
    model = content["model"]
    line = f"calibration of a heliostat; model {model['kind']}, {model['name']}; heliogauge {summary.version}"
    rows = _headline_rows(content, split)
    verdict = verdict_of(summary, missing, passed)
    return page.first_screen(str(content["heliostat"]), line, verdict, rows, first_view(report))


def _headline_rows(content: Mapping[str, Any], split: Mapping[str, Any] | None) -> list[tuple[str, ...]]:
    whole = content["fit_to_all"]
    rows: list[tuple[str, ...]] = []
    if split is not None:
        test = split["test"]
        held = f"{test['n']} observations held out, {content['split']}"
        rows.append(("Beam, RMS of predicted positions", _milli(test["beam_rms_mrad"]), held))
        rows.append(("Normal, RMS of predicted positions", _milli(test["normal_rms_mrad"])))
        rows.append(("Beam, expected beforehand (1 sigma)", _milli(split["predicted_sigma_median_mrad"])))
    rows.append(("Beam, RMS of the fit to all", _milli(whole["beam_rms_mrad"]), f"{whole['n']} observations"))
    rows.append(("Beam, largest residual of the fit", _milli(whole["beam_max_mrad"])))
    rows.append(("Parameters determined", f"{content['rank']} of {content['n_free']}"))
    return [row for row in rows if row[1]]


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


def residual_section(report: HeliostatReport) -> Html:
    """Return residuals on the targets and against time and sun, without the one that stands first."""
    first = first_view(report).name
    views = [*(target_view(report, name) for name in figures.targets_hit(report)), *series_views(report).values()]
    others = [view for view in views if view.name != first]
    return beside(*others) if others else Html("")


def beam_section(report: HeliostatReport) -> Html:
    """Return the most informative beams in photos with their heading; nothing where there are none."""
    view = beam_view(report)
    if view is None:
        return Html("")
    order = "Photos that were left out come first, then the largest residuals, then those around the median; "
    return join(Html("<h2>Beams in the photos</h2>"), view, _caption(f"{order}beams.csv has all."))


def observation_table(report: HeliostatReport) -> TableView:
    """Return all observations with their residuals, and links to the photos that are shown."""
    rows, photos = report.residuals, pictured(report.folder)
    count = range(len(rows))
    columns = [
        TableColumn(
            "observation",
            rows.observation,
            links=[f"#{photos[name]}" if name in photos else "" for name in rows.observation],
        ),
        TableColumn("time", ["" if np.isnat(one) else f"{str(one)[:16]}Z" for one in rows.time]),
        TableColumn("target", rows.target),
        TableColumn("split", rows.split),
    ]
    for name, key in (
        ("right [mrad]", "residual_right_mrad"),
        ("up [mrad]", "residual_up_mrad"),
        ("beam [mrad]", "residual_beam_mrad"),
        ("normal [mrad]", "residual_normal_mrad"),
    ):
        values = rows.numbers[key]
        columns.append(TableColumn(name, [_number(values[i]) for i in count], values.tolist()))
    columns.append(TableColumn("not used, because", [_left_out(rows.flag[i], rows.reason[i]) for i in count]))
    return TableView("observations", tuple(columns), most_rows=30)


def _left_out(flag: str, reason: str) -> str:
    return f"{flag}: {reason}" if flag and reason else flag


def sky_section(report: HeliostatReport) -> Html:
    """Return the map of the predicted uncertainty."""
    if not report.content.get("sky"):
        return Html("<p>The plant has no targets, so nothing is aimed at.</p>")
    caption = "Includes what the residuals show beyond the noise of the observations."
    return join(sky_view(report), _caption(caption))


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
        parts.append(side_by_side([figures.correlation_picture(content["correlation"])]))
    return join(*parts)


def finding_section(report: HeliostatReport) -> Html:
    """Return what the diagnosis found, as sentences with what they rest on and what to do."""
    diagnosis = report.content.get("diagnosis")
    if diagnosis is None:
        return Html("<p>Not made.</p>")
    findings, looks = diagnosis["findings"], len(diagnosis["checks"])
    if not findings:
        text = f"Nothing found in {looks} kinds of check: the heliostat behaves as its model."
        return Html(f"<p>{text}</p>")
    items = []
    for one in findings:
        kind = f"{one['kind'].replace('_', ' ')} ({one['severity']})"
        words = " ".join(filter(None, (one["text"], _significance(one.get("chance")), one["remedy"])))
        items.append(f"<li><strong>{html.escape(kind)}</strong>: {html.escape(words)}</li>")
    limit = diagnosis.get("significance", 0.01)
    note = f"{looks} checks were made; a healthy heliostat gets any finding with a probability of {limit:g}."
    return join(Html(f"<ul>{''.join(items)}</ul>"), _caption(html.escape(note) if looks else ""))


def _significance(chance: float | None) -> str:
    """Say how likely a finding is by chance alone."""
    if chance is None:
        return ""
    return f"Probability by chance: {f'{chance:.1g}' if chance >= 1e-12 else 'below 1e-12'}."


def unused_section(report: HeliostatReport) -> Html:
    """Return the observations that were left out, with the reason."""
    rows, photos = report.residuals, pictured(report.folder)
    left_out = [i for i in range(len(rows)) if rows.flag[i]]
    if not left_out:
        return Html("<p>All observations were used.</p>")
    beam = rows.numbers["residual_beam_mrad"]
    names = [rows.observation[i] for i in left_out]
    shown = (
        TableColumn("observation", names, links=[f"#{photos[name]}" if name in photos else "" for name in names]),
        TableColumn("time", ["" if np.isnat(rows.time[i]) else f"{str(rows.time[i])[:16]}Z" for i in left_out]),
        TableColumn("target", [rows.target[i] for i in left_out]),
        TableColumn("reason", [_left_out(rows.flag[i], rows.reason[i]) for i in left_out]),
        TableColumn("residual of the beam", [_milli(beam[i]) for i in left_out], [float(beam[i]) for i in left_out]),
    )
    return join(TableView("observations that were left out", shown, most_rows=30))


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


def field_screen(report: FieldReport) -> FirstScreen:
    """Return the first screen of a field: verdict, the numbers of its heliostats, the field from above."""
    numbers, summary = report.summary.numbers, report.summary
    count, calibrated, failed, faulty, doubtful = (
        int(numbers.get(f"{kind}_count") or 0) for kind in ("heliostats", "calibrated", "failed", "faulty", "doubtful")
    )
    # Results of earlier versions do not count those without doubt.
    sound = int(numbers.get("without_doubt_count", calibrated - faulty - doubtful) or 0)
    missing = [f"{failed} of {count} heliostats have no model"] if failed else []
    passed = [f"{sound} of {count} heliostats without fault or doubt"] if sound > 0 else []
    verdict = verdict_of(summary, missing, passed)
    if verdict.state is State.SOUND and sound < calibrated:
        verdict = replace(verdict, state=State.DOUBTFUL)
    split = summary.texts.get("split", "")
    line = f"calibration of {count} heliostats; {split} split; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict, _field_rows(report), field_view(report))


def _field_rows(report: FieldReport) -> list[tuple[str, ...]]:
    numbers = report.summary.numbers
    rows: list[tuple[str, ...]] = [
        ("Calibrated", f"{numbers.get('calibrated_count') or 0} of {numbers['heliostats_count']}")
    ]
    for kind, words in (("faulty", "with a fault"), ("doubtful", "with doubts"), ("failed", "without a model")):
        if numbers.get(f"{kind}_count"):
            rows.append((words, str(numbers[f"{kind}_count"])))
    said = [int(cell or 0) for cell in report.rows.get("warnings_count", ())]
    if any(said):
        rows.append(("Doubts of heliostats", str(sum(said)), f"in {sum(map(bool, said))} of them; links in the table"))
    normal = report.numbers("normal_test_rms_mrad")
    for word, values in (("Beam", report.numbers("beam_test_rms_mrad")), ("Normal", normal)):
        if np.isfinite(values).any():
            low, middle, high = np.nanpercentile(values, [5, 50, 95])
            note = f"RMS on predicted positions; 5 % below {low:.2f}, 95 % below {high:.2f} mrad"
            rows.append((f"{word}, median heliostat", f"{middle:.2f} mrad", note))
    sky, ratio = (report.numbers(name) for name in ("predicted_sky_beam_mrad", "found_over_expected"))
    if np.isfinite(sky).any():
        low, middle, high = np.nanpercentile(sky, [5, 50, 95])
        note = f"expected RMS of the beam; 5 % below {low:.2f}, 95 % below {high:.2f} mrad"
        rows.append(("Over the sky, median heliostat", f"{middle:.2f} mrad", note))
    if np.isfinite(ratio).any():
        low, middle, high = np.nanpercentile(ratio, [5, 50, 95])
        rows.append(("Found over expected, median", f"{middle:.2f}", f"5 % below {low:.2f}, 95 % below {high:.2f}"))
    known = normal[np.isfinite(normal)]
    if known.size:
        rows.append(("Normal within 1 mrad RMS", f"{100 * np.mean(known <= 1.0):.0f} % of the heliostats"))
    return rows


def field_distribution(report: FieldReport) -> Html:
    """Return the distribution of the errors; nothing where there is none."""
    view = distribution_view(report)
    return join(view) if view.series else Html("")


def field_work(report: FieldReport) -> Html:
    """Return a plain sentence for each heliostat that needs work, the worst first, with links to their reports."""
    rows = report.rows
    states = [(name, *rest) for name, *rest in zip(rows["heliostat"], rows["status"], rows["work"], strict=True)]
    asked = [
        (name, f"No model: {rows['reason'][k]}" if status == "failed" else work)
        for k, (name, status, work) in enumerate(states)
        if work or status == "failed"
    ]
    if not asked:
        return Html("<p>None: no fault was found, and beams go where they are expected to within what was stated.</p>")
    items = []
    for name, text in asked[:_MOST_SENTENCES]:
        link, shown = _link(report, name), html.escape(name)
        named = f'<a href="{html.escape(link, quote=True)}">{shown}</a>' if link else shown
        items.append(f"<li><strong>{named}</strong>: {html.escape(_shortened(text, _WORK_LENGTH))}</li>")
    more = len(asked) - len(items)
    rest = f" {more} more: field.csv, column work." if more > 0 else ""
    count = f"{len(asked)} of {len(rows['heliostat'])} heliostats need work.{rest}"
    return join(Html(f"<p>{count}</p>"), Html(f"<ul>{''.join(items)}</ul>"))


def field_table(report: FieldReport) -> Html:
    """Return the heliostats, the worst across the sky first, with links to their reports."""
    rows, count = report.rows, len(report.rows["heliostat"])
    kinds = rows.get("diagnosis", ("",) * count)
    states = [kind.replace("_", " ") or status for kind, status in zip(kinds, rows["status"], strict=True)]
    columns = [
        TableColumn("heliostat", rows["heliostat"], links=[_link(report, name) for name in rows["heliostat"]]),
        TableColumn("state", states),
    ]
    for name, key in (
        ("over the sky", "predicted_sky_beam_mrad"),
        ("found", "beam_test_rms_mrad"),
        ("expected", "predicted_sigma_beam_mrad"),
        ("ratio", "found_over_expected"),
        ("normal", "normal_test_rms_mrad"),
    ):
        values = report.numbers(key)
        columns.append(TableColumn(name, [_number(one) for one in values], values.tolist()))
    used = [
        f"{one}/{of}" if one else "" for one, of in zip(rows["used_count"], rows["observations_count"], strict=True)
    ]
    dates = [dates_text(cell.split(", ")) for cell in rows["bad_row_dates"]]
    said = report.rows.get("warnings_count", ("",) * count)
    places = [_link(report, name) or f"{name}/summary.json" for name in rows["heliostat"]]
    links = [place if int(cell or 0) else "" for place, cell in zip(places, said, strict=True)]
    doubts = TableColumn("doubts", [cell or "" for cell in said], [float(cell or 0) for cell in said], links=links)
    columns += [TableColumn("used", used), doubts, TableColumn("bad rows on", dates)]
    command = (
        "<code>heliogauge report OUT/NAME</code> makes the report of one heliostat; <code>heliogauge view OUT</code> "
        "shows all of them."
    )
    note = (
        "Angles of the beam in mrad, RMS. Over the sky: expected wherever the sun stands. Found: beams held out of the "
        "fit; expected: of these beams, before; ratio: found over expected, both RMS. Normal: found, of the mirror's "
        f"normal. Reasons in full in field.csv. {command}"
    )
    ids = [f"heliostat-{name}" for name in rows["heliostat"]]
    return join(TableView("heliostats", tuple(columns), ids), _caption(note))


def _link(report: FieldReport, name: str) -> str:
    is_there = Path(name).name == name and (report.folder / name / "report.html").is_file()
    return f"{name}/report.html" if is_there else ""


def _caption(text: str) -> Html:
    return Html(f'<p class="caption">{text}</p>' if text else "")


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[:length].rsplit(' ', 1)[0]} ..."


def _number(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.2f}"


def _milli(value: float | None) -> str:
    text = _number(value)
    return f"{text} mrad" if text else ""
