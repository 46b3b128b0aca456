"""What the report notebooks call: each function returns a piece of HTML that the cell shows."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from heliogauge.doubts import Doubt, Severity, heaviest_first
from heliogauge.errors import EstimationError
from heliogauge.flags import FLAG_TEXTS, REJECTED, SampleFlag, count_flags
from heliogauge.reporting.html import FirstScreen, Html, Shown, join, sentence, table, wrap
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.results import Results, open_results
from heliogauge.reporting.verdict import State, Verdict, doubt_mark
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, unit_of
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal
from heliogauge.slopes.statistics import statistics

if TYPE_CHECKING:
    from heliogauge.view.maps import Removals

__all__ = [
    "HasSummary",
    "Html",
    "Results",
    "doubts_box",
    "doubts_of",
    "duration_table",
    "first_screen",
    "flag_table",
    "head",
    "headline_numbers",
    "input_table",
    "join",
    "name_and_line",
    "number_table",
    "number_text",
    "open_results",
    "statistics_table",
    "table",
    "text_table",
    "title",
    "verdict_box",
]

#: Numbers of slope maps by key without unit, and what they are called.
LABELS: dict[str, str] = {
    "sdx": "SDx, RMS angle of the normal from the design's in x",
    "sdy": "SDy, RMS angle of the normal from the design's in y",
    "sd": "SD, RMS angle between measured and design normal",
    "sdx_best_focus": "SDx with tilt and focus removed",
    "sdy_best_focus": "SDy with tilt and focus removed",
    "sd_best_focus": "SD with tilt and focus removed",
    "mean_x": "Mean angle of the normal in x",
    "mean_y": "Mean angle of the normal in y",
    "focal_length_x": "Best-fit focal length in x",
    "focal_length_y": "Best-fit focal length in y",
    "canting_x": "Canting in x",
    "canting_y": "Canting in y",
    "measured_share": "Share of the mirror measured",
    "pose_residual": "RMS residual of the mirror's outline",
    "curl_rms": "RMS curl of the slopes (self-check)",
    "curl_expected_rms": "RMS curl expected from the noise",
    "target_distance": "Distance of the target",
}

#: What stands over the box of a verdict.
STATE_WORDS: dict[State, str] = {
    State.SOUND: "Sound: no check found anything doubtful",
    State.DOUBTFUL: "Doubtful: look at these first",
    State.INCOMPLETE: "Incomplete",
    State.FAILED: "Not to be used as it is",
}
#: Doubts in the box of a verdict; the rest is a link away.
MOST_REMARKS = 5
#: Place in a page of the list of all doubts.
_ALL_DOUBTS = "all-doubts"


#: Letters of a headline number that stay on one line: more do not fit beside its label on a phone.
_LONGEST_UNBROKEN = 24


class HasSummary(Protocol):
    """Results of any kind: what title, doubts, times and inputs are shown of."""

    @property
    def summary(self) -> Summary:
        """The summary of the folder."""


def name_and_line(name: str, line: str) -> Html:
    """Return a name as heading of the report with a line below it.

    name, line: Both as text.
    """
    return Html(f'<h1>{html.escape(name)}</h1><p class="subtitle">{html.escape(line)}</p>')


def head(results: HasSummary, line: str) -> Html:
    """Return heading and doubts of a report.

    line: What they are; the version is added.
    Returns: Name, line and the box of doubts.
    """
    summary = results.summary
    return join(name_and_line(summary.name, f"{line}; heliogauge {summary.version}"), doubts_box(results))


def title(results: Results) -> Html:
    """Return the head of the report.

    Returns: Name, kind, design, version.
    """
    summary = results.summary
    line = f"{summary.kind}; design: {results.slope_map.design}; heliogauge {summary.version}"
    return name_and_line(summary.name, line)


def first_screen(
    name: str, line: str, verdict: Verdict, numbers: Sequence[tuple[str, ...]], picture: Shown | None
) -> FirstScreen:
    """Return what a reader sees first: name, verdict and headline numbers on the left, the picture on the right.

    name, line: What was measured, and how, as text.
    numbers: Rows of `headline_numbers`.
    picture: A view or pictures; None: the numbers take the whole width.
    """
    left = wrap('<div class="answer">', [verdict_box(verdict), headline_numbers(numbers)], "</div>")
    right = [] if picture is None else [wrap('<div class="picture">', [picture], "</div>")]
    kind = "first" if right else "first alone"
    whole = join(name_and_line(name, line), wrap(f'<div class="{kind}">', [left, *right], "</div>"))
    return FirstScreen(whole, picture)


def verdict_box(verdict: Verdict) -> Html:
    """Return the verdict: what is wrong, what is missing, what is doubtful, what passed."""
    words = STATE_WORDS[verdict.state]
    if verdict.state is State.INCOMPLETE and verdict.doubtful:
        words = f"{words} and {STATE_WORDS[State.DOUBTFUL].lower()}"
    lines, serious = [f'<li class="missing">{sentence(text)}</li>' for text in verdict.missing], 0
    for remark in verdict.doubtful[:MOST_REMARKS]:
        line = f'<li class="doubtful {remark.severity}"><a href="#{remark.mark}">{sentence(remark.text)}</a></li>'
        if remark.severity is Severity.SERIOUS:
            lines.insert(serious, line)
            serious += 1
        else:
            lines.append(line)
    more = len(verdict.doubtful) - MOST_REMARKS
    if more > 0:
        lines.append(f'<li class="doubtful"><a href="#{_ALL_DOUBTS}">and {more} more</a></li>')
    lines += [f'<li class="passed">{sentence(text)}</li>' for text in verdict.passed]
    if verdict.notes:
        counted = "1 note" if verdict.notes == 1 else f"{verdict.notes} notes"
        lines.append(f'<li class="note"><a href="#{_ALL_DOUBTS}">{counted}</a></li>')
    items = f"<ul>{''.join(lines)}</ul>" if lines else ""
    return Html(f'<div class="verdict {verdict.state}"><strong>{words}</strong>{items}</div>')


def headline_numbers(rows: Iterable[tuple[str, ...]]) -> Html:
    """Return the headline numbers.

    rows: Label, value with sigma and unit, and a note below the label where there is one.
    """
    lines = []
    for label, value, *notes in rows:
        note = "".join(f"<small>{html.escape(text)}</small>" for text in notes if text)
        kind = ' class="long"' if len(value) > _LONGEST_UNBROKEN else ""
        lines.append(f"<tr><th>{html.escape(label)}{note}</th><td{kind}>{html.escape(value)}</td></tr>")
    return Html(f'<table class="numbers"><tbody>{"".join(lines)}</tbody></table>' if lines else "")


def doubts_box(results: HasSummary) -> Html:
    """Return all doubts with all their words, or the statement that there are none."""
    return _doubt_list(results.summary.doubts)


def doubts_of(folder: Path) -> Html:
    """Return the doubts of a folder of results as `doubts_box` does.

    InputError: No summary is in the folder, or it is damaged.
    """
    return _doubt_list(read_summary(folder / SUMMARY_FILE).doubts)


def _doubt_list(doubts: Sequence[Doubt]) -> Html:
    if not doubts:
        return Html("<p>No check found anything doubtful.</p>")
    items = "".join(
        f'<li class="{one.severity}" id="{doubt_mark(number)}">{sentence(one.text)}</li>'
        for number, one in heaviest_first(doubts)
    )
    return Html(f'<ul class="doubts" id="{_ALL_DOUBTS}">{items}</ul>')


def number_table(results: HasSummary) -> Html:
    """Return all numbers of the summary with their standard deviations and units, folded away."""
    numbers, reasons = results.summary.numbers, results.summary.not_determined
    rows = []
    for key, value in numbers.items():
        name, unit = unit_of(key)
        if key.removeprefix("sigma_") in numbers and key.startswith("sigma_"):
            continue
        sigma = numbers.get(f"sigma_{key}")
        shown = f"not determined: {reasons.get(key, '')}" if value is None else number_text(value, sigma, unit, name)
        rows.append((LABELS.get(name, _plain_label(name)), shown))
    values = table(("", "value \u00b1 1 sigma"), rows, numbers=(1,))
    return Html(f"<details><summary>All {len(rows)} numbers</summary>{values.text}</details>" if rows else "")


def _plain_label(name: str) -> str:
    text = name.replace("_", " ")
    for short, proper in (("sdx", "SDx"), ("sdy", "SDy"), ("sd ", "SD "), ("rms", "RMS")):
        text = text.replace(short, proper)
    return text[:1].upper() + text[1:]


def statistics_table(slope_map: SlopeMap, known: "Sequence[Removals]" = ()) -> Html:
    """Return SDx, SDy and SD of a map, as measured and with more and more removed.

    known: Removals of a view of the same map, whose statistics need not be formed again.
    """
    ready = {part.removal: part.statistics for one in known for part in one.parts}
    rows: list[tuple[str, ...]] = []
    for removal in Removal:
        try:
            result = ready.get(removal) or statistics(slope_map, removed=removal)
        except EstimationError as error:  # too few nodes, or all on a line
            rows.append((removal.value, str(error).partition("; ")[0], "", "", ""))
            continue
        pairs = ((result.sdx_rad, result.sigma_sdx_rad), (result.sdy_rad, result.sigma_sdy_rad))
        cells = [number_text(value, sigma, "rad") for value, sigma in (*pairs, (result.sd_rad, result.sigma_sd_rad))]
        more = result.removed.removeprefix(slope_map.removed).strip("; ").removeprefix("then ")
        rows.append((more or "nothing", result.reference, *cells))
    before = "" if slope_map.removed == "nothing" else f"Removed in every row: {slope_map.removed}."
    values = table(("removed", "deviation from", "SDx", "SDy", "SD"), rows, numbers=(2, 3, 4))
    return join(values, Html(f'<p class="caption">{html.escape(before)}</p>' if before else ""))


def flag_table(slope_map: SlopeMap) -> Html:
    """Return how many nodes of the mirror carry each flag."""
    total = max(int(np.count_nonzero(slope_map.aperture)), 1)
    counts = count_flags(slope_map.flags, slope_map.aperture)
    rows = [("measured", "", f"{int(np.count_nonzero(slope_map.valid))}", f"{slope_map.measured_share:.2%}")]
    for flag, count in sorted(counts.items(), key=lambda item: -item[1]):
        effect = "no value" if flag & REJECTED else "kept"
        rows.append((FLAG_TEXTS[SampleFlag(flag)], effect, f"{count}", f"{count / total:.2%}"))
    return table(("nodes of the mirror", "effect", "count", "share"), rows, numbers=(2, 3))


def text_table(results: Results) -> Html:
    """Return the facts in words: design, frame, what was removed, and what the pipeline adds."""
    slope_map = results.slope_map
    own = {"design": slope_map.design, "frame": slope_map.frame, "removed": slope_map.removed}
    rows = [(name.replace("_", " "), text) for name, text in (own | dict(results.summary.texts)).items()]
    rows.append(("share measured", f"{slope_map.measured_share:.2%}"))
    rows.append(("software", f"heliogauge {results.summary.version}"))
    return table(("", ""), rows)


def duration_table(results: HasSummary) -> Html:
    """Return how long each stage took."""
    durations = results.summary.durations_s
    rows = [(stage, f"{seconds:.2f} s") for stage, seconds in durations.items()]
    return table(("stage", "wall time"), [*rows, ("together", f"{sum(durations.values()):.2f} s")], numbers=(1,))


def input_table(results: HasSummary) -> Html:
    """Return the files that were read, with their hashes, folded away."""
    hashes = results.summary.input_sha256
    rows = "".join(
        f'<tr><td>{html.escape(name)}</td><td class="hash">{html.escape(digest)}</td></tr>'
        for name, digest in hashes.items()
    )
    head = "<thead><tr><th>file</th><th>SHA-256</th></tr></thead>"
    body = f'<div class="table"><table>{head}<tbody>{rows}</tbody></table></div>'
    return Html(f"<details><summary>{len(hashes)} input files with their SHA-256</summary>{body}</details>")
