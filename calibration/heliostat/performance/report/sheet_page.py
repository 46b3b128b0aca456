"""The data sheet of a heliostat as one page: A4 on paper, one column on a telephone."""

import html
from itertools import groupby

from calibration.heliostat.performance.entries import Conformity, Entry, Limit
from calibration.heliostat.performance.files.result import value_text
from calibration.heliostat.performance.report.sections import TEST_WORDS, series_chart
from calibration.heliostat.performance.sheet import STANDARD, Sheet, SheetLine, decision_rule
from heliogauge import __version__
from heliogauge.doubts import heaviest_first
from heliogauge.reporting.notation import quantity_text
from heliogauge.reporting.page_frame import POLICY_HEAD
from heliogauge.reporting.style import STYLE

_MOST_DOUBTS = 5
#: Half a page wide, with letters that can be read on paper and on a telephone.
_CHART_PX = 370.0
_HEAD = (
    ("manufacturer", "Manufacturer"),
    ("model", "Model"),
    ("year", "Year"),
    ("mirror", "Mirror"),
    ("facets", "Facets"),
    ("focal_length", "Focal length"),
    ("drive", "Drive"),
    ("controller", "Controller"),
    ("glass", "Glass"),
    ("pedestal", "Pedestal"),
    ("mass", "Mass"),
    ("position", "Position"),
    ("site", "Site"),
    ("conditions", "Conditions"),
)
_MARKS = {
    Conformity.PASS: "good",
    Conformity.CONDITIONAL_PASS: "warn",
    Conformity.CONDITIONAL_FAIL: "warn",
    Conformity.UNDECIDED: "warn",
    Conformity.FAIL: "bad",
    Conformity.NOT_MEASURED: "none",
    Conformity.NO_LIMIT: "none",
}
_SHEET_STYLE = """
main.sheet { max-width: 900px; }
.letterhead { display: flex; justify-content: space-between; gap: 1em; border-bottom: 2px solid var(--ink); }
.letterhead p { margin: .2em 0; }
.letterhead .right { text-align: right; white-space: nowrap; }
.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(15em, 1fr)); gap: 0 1.2em; margin: .4em 0; }
.facts div { font-size: .88em; }
.facts b { font-weight: 400; color: var(--faint); }
.sheet table { width: 100%; }
.sheet td { padding: .2em .5em .2em .1em; }
.sheet tr.group td { background: var(--code); font-size: .84em; color: var(--faint); }
.sheet tr.group b { color: var(--ink); }
.sheet td.mark { white-space: nowrap; font-weight: 600; }
.sheet .good { color: var(--good); }
.sheet .warn { color: var(--warn); }
.sheet .bad { color: var(--bad); }
.sheet .none { color: var(--faint); font-weight: 400; }
.sheet small { color: var(--faint); }
.sheet .rule { font-size: .8em; color: var(--faint); margin: .4em 0; max-width: none; }
.sheet .cost { display: grid; grid-template-columns: 1fr 1fr; gap: 1em; align-items: start; margin: .5em 0; }
.sheet .cost h2, .sheet h2 { font-size: 1.02em; margin: .5em 0 .2em; padding: 0; border: 0; }
.sheet .cost figure { margin: 0; }
.sheet .cost img { width: 100%; height: auto; }
.sheet td.number { white-space: nowrap; }
.signatures { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1.6em; margin-top: 2.2em; }
.signatures div { border-top: 1px solid var(--ink); padding-top: .2em; font-size: .84em; color: var(--faint); }
@media (max-width: 600px) {
  .sheet table, .sheet tbody, .sheet tr, .sheet td { display: block; }
  .sheet thead { display: none; }
  .sheet td { border: 0; padding: 0 .1em; text-align: left; }
  .sheet td.number { display: inline-block; margin-right: .8em; font-weight: 600; }
  .sheet td.mark, .sheet td.limit { display: inline-block; margin-right: .8em; }
  .sheet tr { border-bottom: 1px solid var(--line); padding: .25em 0; }
  .sheet .cost { grid-template-columns: 1fr; }
  .signatures { grid-template-columns: 1fr; }
}
@page { size: A4; margin: 11mm 13mm 10mm; }
@media print {
  main.sheet { font-size: 8.4pt; line-height: 1.22; }
  .sheet h1 { font-size: 14pt; margin: .2em 0 0; }
  .sheet .subtitle { margin: 0 0 .2em; }
  .sheet table { font-size: 7.7pt; }
  .sheet th, .sheet td, .sheet td.number { padding: .05em .5em .05em .1em; white-space: nowrap; }
  .sheet tr.group td { white-space: normal; font-size: 7pt; }
  .sheet td:first-child { white-space: normal; }
  .sheet .rule { font-size: 6.8pt; margin: .2em 0; }
  .sheet .doubts { margin: .1em 0; font-size: 7.4pt; }
  .sheet .doubts li { margin: 0; }
  .sheet .cost img { max-height: 45mm; width: auto; max-width: 100%; }
  .facts { grid-template-columns: repeat(3, 1fr); }
  .sheet .cost { grid-template-columns: 5fr 6fr; }
  .signatures { margin-top: 8mm; }
}
"""


def sheet_page(sheet: Sheet, confidence: float, *, printed: bool = False) -> str:
    """Return the data sheet as a whole page.

    confidence: Probability at which passing or failing counts as proven.
    printed: As it is printed: without the entries that a browser shows folded away.
    """
    chosen = [line for line in sheet.lines if is_main(line)]
    body = [
        _letterhead(sheet),
        f"<h1>Data sheet of heliostat {html.escape(sheet.name)}</h1>",
        f'<p class="subtitle">{html.escape(_verdict(sheet))}</p>',
        _facts(sheet),
        _table(chosen),
        '<p class="rule">Values with one standard uncertainty (k = 1). '
        f"{html.escape(decision_rule(confidence))}. Angles of the beam and of the normal are named; in the "
        "plane of incidence the beam turns by twice the "
        "normal's angle.</p>",
        _below(sheet),
        _remarks(sheet),
        _signatures(sheet),
    ]
    if not printed:
        body.append(
            f"<details><summary>All {len(sheet.lines)} entries with method, conditions and notes</summary>"
            f"{_annex(sheet)}</details>"
        )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">{POLICY_HEAD}'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        "<title>Data sheet of heliostat "
        f"{html.escape(sheet.name)}</title>\n<style>\n{STYLE}{_SHEET_STYLE}</style></head>\n"
        f'<body><main class="sheet">\n{"".join(body)}\n</main></body></html>\n'
    )


def is_main(line: SheetLine) -> bool:
    """Whether a line is on the printed page: the standard ones, what has a limit, and what was given by hand."""
    standard = {(test, key) for test, key, _ in STANDARD}
    return line.limit is not None or line.entry.test == "given" or (line.entry.test, line.entry.key) in standard


def _verdict(sheet: Sheet) -> str:
    said = [f"{sheet.count(state)} {state}" for state in Conformity if state and sheet.count(state)]
    return f"{'; '.join(said) or 'no limits were stated'}; heliogauge {__version__}"


def _letterhead(sheet: Sheet) -> str:
    about = sheet.about
    left = html.escape(about.get("laboratory", "Laboratory: not stated"))
    parts = [f"Order {about['order']}" if about.get("order") else "", about.get("date", "")]
    right = html.escape("; ".join(part for part in parts if part))
    return f'<div class="letterhead"><p>{left}</p><p class="right">{right}</p></div>'


def _facts(sheet: Sheet) -> str:
    cells = [
        f"<div><b>{label}</b> {html.escape(sheet.about[key])}</div>" for key, label in _HEAD if sheet.about.get(key)
    ]
    return f'<div class="facts">{"".join(cells)}</div>'


def _table(lines: list[SheetLine]) -> str:
    rows = [
        "<thead><tr><th>Quantity</th><th class='number'>Value</th><th "
        "class='number'>Limit</th><th>Result</th></tr></thead>"
    ]
    ordered = sorted(
        lines, key=lambda line: list(TEST_WORDS).index(line.entry.test) if line.entry.test in TEST_WORDS else 99
    )
    for test, group in groupby(ordered, key=lambda line: line.entry.test):
        own = list(group)
        measured = [line.entry for line in own if line.entry.is_measured]
        first = _circumstances(measured)
        words = " not measured" if not measured else f" {html.escape('; '.join(filter(None, first)))}"
        rows.append(f'<tr class="group"><td colspan="4"><b>{TEST_WORDS.get(test, test)}</b>{words}</td></tr>')
        rows += [_row(line, first) for line in own]
    return f"<table>{''.join(rows)}</table>"


def _circumstances(measured: list[Entry]) -> tuple[str, str, str]:
    """Return method, date and conditions of the first entry; those that differ say their own."""
    first = measured[0] if measured else Entry("", "", "", None)
    return first.method, first.date, first.conditions


def _row(line: SheetLine, shared: tuple[str, str, str]) -> str:
    entry, state = line.entry, line.decision.conformity
    value = html.escape(value_text(entry))
    if not entry.is_measured:
        value = f'<span class="none">{value}</span>'
    if entry.value is not None and entry.sigma is None:
        value += ' <small class="none">no uncertainty</small>'
    mark = str(state)
    if line.decision.probability is not None and state not in (Conformity.PASS, Conformity.FAIL):
        mark += f" ({100 * line.decision.probability:.0f} %)"
    limit = html.escape(limit_text(entry, line.limit)) if line.limit else ""
    own = [part for part in (entry.method or "method not stated", entry.date, entry.conditions) if part]
    own = [part for part in own if part not in shared]
    more = f" <small>{html.escape('; '.join(own))}</small>" if own and entry.is_measured else ""
    return (
        f'<tr><td>{html.escape(entry.label)}{more}</td><td class="number">{value}</td>'
        f'<td class="number limit">{limit}</td>'
        f'<td class="mark {_MARKS[state]}">{html.escape(mark)}</td></tr>'
    )


def limit_text(entry: Entry, limit: Limit) -> str:
    """Return a limit as people read it, in the unit of the entry's value."""

    def said(value: float) -> str:
        return quantity_text(entry.key, value, None)

    if limit.least is not None and limit.most is not None:
        return f"{said(limit.least)} to {said(limit.most)}"
    return f"\u2265 {said(limit.least)}" if limit.least is not None else f"\u2264 {said(limit.most or 0.0)}"


def _below(sheet: Sheet) -> str:
    """Return the picture of the day and what errors cost, side by side."""
    pieces = []
    if "day_rows" in sheet.tables:
        chart = series_chart(sheet.tables["day_rows"], "Error of the beam")
        pieces.append(f"<div>{chart.still(width=_CHART_PX)._repr_html_()}</div>")
    if "year_costs" in sheet.tables:
        table = sheet.tables["year_costs"]
        rows = "".join(
            f"<tr><td>{html.escape(cause)}</td><td class='number'>{html.escape(lost)}</td><td "
            f"class='number'>{html.escape(more)}</td></tr>"
            for cause, lost, more in zip(table["cause"], table["lost_text"], table["next_mrad_text"], strict=True)
        )
        pieces.append(
            "<div><h2>What an error costs over a year</h2><small>energy lost (size of the error); one mrad "
            "more</small><table><thead><tr><th>Cause</th><th "
            "class='number'>energy lost</th>"
            f"<th class='number'>one mrad more</th></tr></thead>{rows}</table></div>"
        )
    return f'<div class="cost">{"".join(pieces)}</div>' if pieces else ""


def _remarks(sheet: Sheet) -> str:
    if not sheet.doubts:
        return ""
    heaviest = [one for _, one in heaviest_first(sheet.doubts)]
    items = "".join(f"<li>{html.escape(one.text)}</li>" for one in heaviest[:_MOST_DOUBTS])
    more = len(sheet.doubts) - _MOST_DOUBTS
    items += f"<li>and {more} more, in summary.json</li>" if more > 0 else ""
    if sheet.doubted:
        said = "; ".join(f"{folder}: {count}" for folder, count in sheet.doubted.items())
        items += f"<li>Doubts of the results, in their own reports: {html.escape(said)}</li>"
    return f'<h2>Remarks</h2><ul class="doubts">{items}</ul>'


def _signatures(sheet: Sheet) -> str:
    about = sheet.about
    cells = (
        ("Place and date", ""),
        ("Measured by", about.get("operator", "")),
        ("Approved by", about.get("approved_by", "")),
    )
    body = "".join(f"<div>{label}{': ' + html.escape(name) if name else ''}</div>" for label, name in cells)
    return f'<div class="signatures">{body}</div>'


def _annex(sheet: Sheet) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(one.entry.label)}</td><td class='number'>{html.escape(value_text(one.entry))}</td>"
        f"<td>{html.escape(one.entry.method)}; "
        f"{html.escape(one.entry.conditions)}</td><td>{html.escape(one.entry.note)}</td></tr>"
        for one in sheet.lines
    )
    return f"<table><tbody>{rows}</tbody></table>"
