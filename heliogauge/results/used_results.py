"""What is made from results cannot be better than they are: serious doubts about them are handed on."""

from collections.abc import Mapping
from pathlib import Path

from heliogauge.doubts import Doubt, Severity
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary

#: Results that a doubt names; the clause of each is cut to so many letters.
_SHOWN, _MOST_LETTERS = 4, 160


def serious_results(summaries: Mapping[str, Summary]) -> Doubt | None:
    """Return a serious doubt where results that are used are seriously doubtful themselves.

    summaries: Of each result that is used, by what it is called.
    """
    found = {
        name: [one.text for one in summary.doubts if one.severity is Severity.SERIOUS]
        for name, summary in summaries.items()
    }
    bad = {name: texts for name, texts in found.items() if texts}
    if not bad:
        return None
    said = "; ".join(f"{name}: {_shortened(texts[0])}" for name, texts in list(bad.items())[:_SHOWN])
    more = f"; and {len(bad) - _SHOWN} more" if len(bad) > _SHOWN else ""
    text = f"made from results that are not to be used as they stand, so neither is this: {said}{more}"
    return Doubt("used_results_serious", text, {"results_count": len(bad)}, Severity.SERIOUS)


def serious_result(folder: Path) -> Doubt | None:
    """Return the same of one folder of results; None where it has no summary."""
    if not (folder / SUMMARY_FILE).is_file():
        return None
    return serious_results({str(folder): read_summary(folder)})


def _shortened(text: str) -> str:
    return text if len(text) <= _MOST_LETTERS else text[:_MOST_LETTERS].rpartition(" ")[0] + " \u2026"
