"""What is made from results cannot be better than they are: doubts about them, and what they share, are said again."""

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


def doubted_results(summaries: Mapping[str, Summary]) -> tuple[Doubt, ...]:
    """Return what is doubtful of results that are used: what is serious, and, in one doubt, what is not.

    summaries: Of each result that is used, by what it is called.
    """
    found = {
        name: [one.text for one in summary.doubts if one.severity is Severity.DOUBT]
        for name, summary in summaries.items()
    }
    lesser = {name: texts for name, texts in found.items() if texts}
    serious = serious_results(summaries)
    handed = () if serious is None else (serious,)
    if not lesser:
        return handed
    said = "; ".join(
        f"{name}: {_shortened(texts[0])}" + (f" (and {len(texts) - 1} more)" if len(texts) > 1 else "")
        for name, texts in list(lesser.items())[:_SHOWN]
    )
    more = f"; and {len(lesser) - _SHOWN} more" if len(lesser) > _SHOWN else ""
    text = f"made from results that are doubtful, which holds here too: {said}{more}"
    return (*handed, Doubt("used_results_doubtful", text, {"results_count": len(lesser)}))


def shared_files(first: Summary, other: Summary, advice: str = "") -> Doubt | None:
    """Return a doubt where two results that are compared were measured from the same files; None where from none.

    advice: What can be done where they share some, if anything.
    """
    hashes = [one.input_sha256 for one in (first, other)]
    common = sorted({name for name, digest in hashes[0].items() if digest in set(hashes[1].values())})
    if not common:
        return None
    if {*hashes[0].values()} == {*hashes[1].values()}:
        return Doubt(
            "same_measurement_twice",
            "both results were evaluated from the same files: their noise is the same, and no sigma here applies; "
            "compare results of two measurements",
        )
    names = ", ".join(common[:3]) + (f" and {len(common) - 3} more" if len(common) > 3 else "")
    return Doubt(
        "inputs_shared",
        f"both results read {names}: what is wrong with that is in both and partly cancels, so that sigmas of the "
        f"difference are upper bounds{advice}",
        {"files_count": len(common)},
        Severity.NOTE,
    )


def serious_result(folder: Path) -> Doubt | None:
    """Return the same of one folder of results; None where it has no summary."""
    if not (folder / SUMMARY_FILE).is_file():
        return None
    return serious_results({str(folder): read_summary(folder)})


def _shortened(text: str) -> str:
    return text if len(text) <= _MOST_LETTERS else text[:_MOST_LETTERS].rpartition(" ")[0] + " \u2026"
