"""From a store to trends, what events did, and the worst subjects of each quantity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from calibration.survey.files.moments import BEYOND, FIRST, read_day
from calibration.survey.files.parquet_store import doubts_of_results, explain_disk, query, reading, strangers
from calibration.survey.judgement import chance, changes, trends
from calibration.survey.worse import extreme, headlines, rank, worse
from heliogauge.doubts import Doubt, doubts_of_parts, gather_doubts
from heliogauge.errors import InputError
from heliogauge.instruments import near_match
from heliogauge.reporting.notation import quantity_text
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

#: Subjects of each quantity in worst.csv, and quantities in the headline.
_WORST, _HEADLINES = 20, 6
#: Chance below which a change counts, shared by all subjects that are looked at (Bonferroni).
CHANCE = 0.05
_YEAR_S = 31_557_600.0


@dataclass(frozen=True, slots=True)
class SurveyOptions(ShortRepr):
    """Choices of the report.

    Parameters
    ----------
    quantities : tuple of str or None
        Which; None: all that have a sigma.
    since : str or None
        Day from which on results count; None: all.
    until : str or None
        Day before which they count; None: all.
    """

    quantities: tuple[str, ...] | None = None
    since: str | None = None
    until: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SurveyResult(InstrumentResult):
    """What a store says.

    overview: Subjects, results and dates of each quantity.
    trends: Mean and change in a year of each subject and quantity.
    worst: The worst subjects of each quantity; the largest values where worse has no meaning.
    events: Before and after each event.
    history: Results of the worst subject of each quantity over time.
    """

    kind: ClassVar[str] = "survey"
    overview: Mapping[str, Sequence[Any]]
    trends: Mapping[str, Sequence[Any]]
    worst: Mapping[str, Sequence[Any]]
    events: Mapping[str, Sequence[Any]]
    history: Mapping[str, Sequence[Any]]
    counts: Mapping[str, int] = field(default_factory=dict)

    def summarise(self) -> Summary:
        """Collect how much there is and how many changes are significant."""
        significant = sum(1 for one in self.trends["chance_of_none"] if one < _shared(len(self.trends["subject"])))
        numbers: dict[str, float | int | None] = {f"{name}_count": count for name, count in self.counts.items()}
        numbers["trends_count"] = len(self.trends["subject"])
        numbers["trends_significant_count"] = significant
        numbers["events_count"] = len(set(zip(self.events["date"], self.events["what"], strict=True)))
        texts = {
            "sigma": "1 standard deviation; enlarged where results scatter more than their sigmas say (Birge's ratio)",
            "rows": "beams of one day are joined to their mean; its sigma has their scatter, neighbours' "
            "correlation counted",
            "trend": "straight line through the results of a subject, weighted by 1 / sigma^2; 3 results at least",
            "event": "weighted mean after minus before, up to the subject's next event",
            "chance": "probability of a change at least as large where there is none",
        }
        return self._summary(numbers, texts)

    def write_files(self, folder: Path) -> None:
        """Write the tables into an existing folder."""
        for name in ("overview", "trends", "worst", "events", "history"):
            write_table_csv(folder / f"{name}.csv", getattr(self, name))

    def headline(self) -> str:
        """Return how much there is, and the worst of the quantities that people look at first."""
        lines = [
            f"{self.counts.get('subjects', 0)} subjects, {self.counts.get('results', 0)} results, "
            f"{self.counts.get('rows', 0)} rows"
        ]
        first: dict[str, int] = {}
        for row, quantity in enumerate(self.worst["quantity"]):
            first.setdefault(quantity, row)
        for quantity in headlines(list(first), _HEADLINES):
            row = first[quantity]
            value = quantity_text(quantity, self.worst["mean"][row], self.worst["sigma_mean"][row])
            part = f" {self.worst['part'][row]}".rstrip()
            lines.append(f"  {quantity}: {extreme(quantity)} {self.worst['subject'][row]}{part}, {value}")
        if len(first) > _HEADLINES:
            lines.append(f"  worst.csv has all {len(first)} quantities")
        return "\n".join(lines)


def _shared(count: int) -> float:
    return CHANCE / max(count, 1)


#: What has weight: results with a sigma, and of rows (beams) one mean for each day. Beams of one day share its weather
#: and remember each other: the sigma of their mean is that of the scatter with the correlation of neighbours counted.
_RESULTS = """
CREATE TABLE results AS
SELECT subject, part, quantity, time, value, sigma FROM chosen SEMI JOIN wanted USING (quantity)
WHERE NOT suffix(kind, '-row') AND sigma > 0 AND NOT isnan(sigma)
UNION ALL
SELECT subject, part, quantity, day + INTERVAL 12 HOUR AS time, mean AS value,
sqrt(greatest(inner_variance, coalesce(spread, 0) / number * (1 + alike) / (1 - alike))) AS sigma
FROM (
    SELECT subject, part, quantity, day, sum(w * value) / sum(w) AS mean, 1 / sum(w) AS inner_variance,
    var_samp(value) AS spread, count(*) AS number,
    greatest(0, least(0.95, coalesce(nullif(corr(value, earlier), 'nan'), 0))) AS alike
    FROM (
        SELECT subject, part, quantity, value, 1 / (sigma * sigma) AS w, CAST(time AS DATE) AS day, lag(value) OVER (
            PARTITION BY subject, part, quantity, CAST(time AS DATE) ORDER BY time
        ) AS earlier
        FROM chosen SEMI JOIN wanted USING (quantity)
        WHERE suffix(kind, '-row') AND sigma > 0 AND NOT isnan(sigma)
    ) GROUP BY subject, part, quantity, day
)
"""
_SUMS = """
count(*) AS count, sum(w) AS w, sum(w * t) AS wt, sum(w * y) AS wy, sum(w * t * t) AS wtt, sum(w * t * y) AS wty,
sum(w * y * y) AS wyy
"""


def run(store: Path, options: SurveyOptions | None = None, progress: Progress | None = None) -> SurveyResult:
    """Query a store.

    Parameters
    ----------
    store : Path
        Folder of the store.
    options : SurveyOptions, optional
        Which quantities and days.
    progress : Progress, optional
        Listener for the stages.

    Returns
    -------
    SurveyResult
        Trends, the worst, and what events did.

    Raises
    ------
    InputError
        No store, an empty one, a quantity that is not in it, or a day that is none.

    Notes
    -----
    Straight lines and means are weighted by 1 / sigma^2; where results scatter more than their sigmas say, the sigmas
    are enlarged by Birge's ratio. Results without a sigma have no weight.
    """
    options, progress = options or SurveyOptions(), progress or SilentProgress()
    with explain_disk(store), reading(store, progress.say):
        for name in strangers(store):
            progress.say(
                f"{store}: {name} is not in the manifest and does not count; `heliogauge survey check {store}`"
            )
        result = _judge(store, options, progress)
    return replace(result, durations_s=dict(progress.durations_s))


def _judge(store: Path, options: SurveyOptions, progress: Progress) -> SurveyResult:
    with query(store) as connection, progress.stage("query"):
        where = _between(options)
        # Rows without a sigma have no weight: they are counted in the overview alone.
        connection.execute(f"CREATE VIEW chosen AS SELECT * FROM rows WHERE {where}")
        overview = connection.execute(
            "SELECT quantity, count(DISTINCT subject || '/' || part) AS subjects, count(*) AS rows, "
            "count(sigma) FILTER "
            "(NOT isnan(sigma) AND sigma > 0) AS with_sigma, min(time) AS first, max(time) AS last FROM chosen "
            "GROUP BY "
            "quantity ORDER BY subjects DESC, rows DESC, quantity"
        ).fetchnumpy()
        counts = dict(
            zip(
                ("subjects", "results", "rows"),
                connection.execute(
                    "SELECT count(DISTINCT subject), count(DISTINCT result), count(*) FROM chosen"
                ).fetchone(),
                strict=True,
            )
        )
        if not counts["rows"]:
            raise InputError(f"{store}: no results between these days")
        quantities = _quantities(options, overview)
        connection.execute("CREATE TABLE wanted (quantity VARCHAR)")
        # A store may have no quantity with a sigma: then trends, worst and history are empty.
        connection.execute("INSERT INTO wanted SELECT unnest(?::VARCHAR[])", [quantities])
        connection.execute(_RESULTS)
        connection.execute(
            "CREATE TABLE centers AS SELECT quantity, median(value) AS y0, min(time) AS t0 FROM results GROUP "
            "BY quantity"
        )
        connection.execute(
            "CREATE VIEW weighted AS SELECT subject, part, quantity, time, y0, 1 / (sigma * sigma) AS w, value "
            "- y0 AS y, "
            f"epoch(time - t0) / {_YEAR_S} AS t FROM results JOIN centers USING (quantity)"
        )
        lines = connection.execute(
            f"SELECT subject, part, quantity, any_value(y0) AS y0, max(time) AS last, {_SUMS} FROM weighted "
            "GROUP BY subject, "
            "part, quantity ORDER BY quantity, subject, part"
        ).fetchnumpy()
        table = _trend_table(lines)
        worst = _worst(table, quantities)
        history = _history(connection, worst)
        events = _events(connection)
        results = [name for (name,) in connection.execute("SELECT DISTINCT result FROM chosen").fetchall()]
    of_results = doubts_of_parts(doubts_of_results(store, results), "results")
    return SurveyResult(
        overview=_overview(overview),
        trends=table,
        worst=worst,
        events=events,
        history=history,
        counts={name: int(count) for name, count in counts.items()},
        name=store.resolve().name,
        doubts=gather_doubts(_doubts(overview, quantities, table, events), of_results),
    )


def _between(options: SurveyOptions) -> str:
    parts = ["TRUE"]
    for name, day, sign in (("since", options.since, ">="), ("until", options.until, "<")):
        if day is not None:
            # The text is made of the parsed day, never of what was typed.
            parts.append(f"time {sign} TIMESTAMP '{read_day(day, name)}'")
    return " AND ".join(parts)


def _quantities(options: SurveyOptions, overview: Mapping[str, Any]) -> list[str]:
    known = [str(one) for one in overview["quantity"]]
    if options.quantities is not None:
        for one in options.quantities:
            if one not in known:
                raise InputError(f"quantity {one!r} is not in the store; {near_match(one, known)}")
        return list(dict.fromkeys(options.quantities))
    weighted = [name for name, count in zip(known, overview["with_sigma"], strict=True) if count > 0]
    # What people look at first; the sort keeps the order of the most subjects within.
    return sorted(weighted, key=rank)


def _trend_table(lines: Mapping[str, Any]) -> dict[str, Sequence[Any]]:
    sums = {name: np.asarray(lines[name], dtype=np.float64) for name in ("count", "w", "wt", "wy", "wtt", "wty", "wyy")}
    found = trends(sums)
    origin = np.asarray(lines["y0"], dtype=np.float64)
    likely = np.nan_to_num(chance(found.slope_per_year, found.sigma_slope, found.degrees), nan=1.0)
    return {
        "quantity": [str(one) for one in lines["quantity"]],
        "subject": [str(one) for one in lines["subject"]],
        "part": [str(one) for one in lines["part"]],
        "results_count": found.count.tolist(),
        "mean": (origin + found.mean).tolist(),
        "sigma_mean": found.sigma_mean.tolist(),
        "slope_per_year": found.slope_per_year.tolist(),
        "sigma_slope_per_year": found.sigma_slope.tolist(),
        "chance_of_none": likely.tolist(),
        "birge_ratio": found.birge.tolist(),
        "last": [f"{one}Z" for one in np.asarray(lines["last"]).astype("datetime64[s]")],
    }


def _worst(table: Mapping[str, Sequence[Any]], order: Sequence[str]) -> dict[str, Sequence[Any]]:
    kept: list[int] = []
    quantities = np.array(table["quantity"], dtype=object)
    mean = np.array(table["mean"], dtype=np.float64)
    for quantity in order:
        rows = np.flatnonzero(quantities == quantity)
        size = mean[rows] if worse(quantity) == "smaller" else -np.abs(mean[rows])
        kept += rows[np.argsort(size, kind="stable")[:_WORST]].tolist()
    names = ("quantity", "subject", "part", "mean", "sigma_mean", "results_count", "last")
    columns: dict[str, Sequence[Any]] = {name: [table[name][row] for row in kept] for name in names}
    return columns | {"worse": [worse(quantity) for quantity in columns["quantity"]]}


def _history(connection: Any, worst: Mapping[str, Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Return the results of the worst subject of each quantity."""
    pieces = []
    seen: set[str] = set()
    for quantity, subject, part in zip(worst["quantity"], worst["subject"], worst["part"], strict=True):
        if quantity in seen:
            continue
        seen.add(quantity)
        pieces.append(
            connection.execute(
                "SELECT quantity, subject, part, time, value, sigma FROM chosen WHERE quantity = ? AND subject "
                "= ? AND part "
                "= ? AND sigma > 0 ORDER BY time LIMIT 2000",
                [quantity, subject, part],
            ).fetchnumpy()
        )
    names = ("quantity", "subject", "part", "time", "value", "sigma")
    found: dict[str, list[Any]] = {name: [] for name in names}
    for piece in pieces:
        for name in names:
            column = np.asarray(piece[name])
            found[name] += [f"{one}Z" for one in column.astype("datetime64[s]")] if name == "time" else column.tolist()
    return dict(found)


def _events(connection: Any) -> dict[str, Sequence[Any]]:
    names = ["date", "what", "subject", "part", "quantity", "before", "sigma_before", "after", "sigma_after"]
    names += ["change", "sigma_change", "chance_of_none"]
    if not connection.execute("SELECT count(*) FROM events").fetchone()[0]:
        return {name: [] for name in names}
    # Of each subject the results from its event before to its next event.
    connection.execute(
        "CREATE TABLE spans AS SELECT s.subject AS subject, e.event_time, e.what, coalesce(lag(e.event_time) "
        f"OVER p, TIMESTAMP '{FIRST}') AS since, coalesce(lead(e.event_time) OVER p, TIMESTAMP '{BEYOND}') AS until "
        "FROM (SELECT DISTINCT "
        "subject FROM weighted) s JOIN events e ON s.subject GLOB e.subject WINDOW p AS (PARTITION BY "
        "s.subject ORDER BY "
        "e.event_time)"
    )
    rows = connection.execute(
        f"""
        SELECT sp.event_time AS date, sp.what, sp.subject, x.part, x.quantity, any_value(x.y0) AS y0,
        {", ".join(f"coalesce(sum({term}) FILTER (x.time < sp.event_time), 0) AS b_{name}" for name, term in _TERMS)},
        {", ".join(f"coalesce(sum({term}) FILTER (x.time >= sp.event_time), 0) AS a_{name}" for name, term in _TERMS)}
        FROM spans sp JOIN weighted x ON x.subject = sp.subject AND x.time >= sp.since AND x.time < sp.until
        GROUP BY sp.event_time, sp.what, sp.subject, x.part, x.quantity HAVING b_count > 0 AND a_count > 0
        ORDER BY x.quantity, sp.subject, sp.event_time
        """
    ).fetchnumpy()
    sides = [{name: np.asarray(rows[f"{side}_{name}"], dtype=np.float64) for name, _ in _TERMS} for side in ("b", "a")]
    found = changes(sides[0], sides[1])
    origin: FloatArray = np.asarray(rows["y0"], dtype=np.float64)
    return {
        "date": [str(one) for one in np.asarray(rows["date"]).astype("datetime64[D]")],
        "what": [str(one) for one in rows["what"]],
        "subject": [str(one) for one in rows["subject"]],
        "part": [str(one) for one in rows["part"]],
        "quantity": [str(one) for one in rows["quantity"]],
        "before": (origin + found.before).tolist(),
        "sigma_before": found.sigma_before.tolist(),
        "after": (origin + found.after).tolist(),
        "sigma_after": found.sigma_after.tolist(),
        "change": found.change.tolist(),
        "sigma_change": found.sigma.tolist(),
        "chance_of_none": np.nan_to_num(chance(found.change, found.sigma, found.degrees), nan=1.0).tolist(),
    }


_TERMS = (
    ("count", "1"),
    ("w", "w"),
    ("wt", "w * t"),
    ("wy", "w * y"),
    ("wtt", "w * t * t"),
    ("wty", "w * t * y"),
    ("wyy", "w * y * y"),
)


def _overview(found: Mapping[str, Any]) -> dict[str, Sequence[Any]]:
    return {
        "quantity": [str(one) for one in found["quantity"]],
        "subjects_count": np.asarray(found["subjects"]).tolist(),
        "rows_count": np.asarray(found["rows"]).tolist(),
        "with_sigma_count": np.asarray(found["with_sigma"]).tolist(),
        "first": [f"{one}Z" for one in np.asarray(found["first"]).astype("datetime64[s]")],
        "last": [f"{one}Z" for one in np.asarray(found["last"]).astype("datetime64[s]")],
    }


def _doubts(
    overview: Mapping[str, Any],
    quantities: list[str],
    table: Mapping[str, Sequence[Any]],
    events: Mapping[str, Sequence[Any]],
) -> tuple[Doubt, ...]:
    found = []
    columns = (overview["quantity"], overview["rows"], overview["with_sigma"])
    without = [
        str(name)
        for name, rows, known in zip(*columns, strict=True)
        if known < rows and (name in quantities or not quantities)
    ]
    if without:
        more = f" and {len(without) - 5} more" if len(without) > 5 else ""
        text = (
            f"results without an uncertainty have no weight in means and trends: some of {', '.join(without[:5])}{more}"
            if quantities
            else f"none of {len(without)} quantities has an uncertainty, so that none has a weight: overview.csv lists "
            "them, and there are neither means nor trends"
        )
        found.append(Doubt("results_without_sigma", text, {"quantities_count": len(without)}))
    wide = [ratio for ratio in table["birge_ratio"] if ratio > 3]
    if wide:
        found.append(
            Doubt(
                "scatter_beyond_sigma",
                f"{len(wide)} series scatter more than three times what their sigmas say; their sigmas here are "
                "enlarged, but "
                "what is between the dates (weather, another operator, a repair that is not noted) is not in "
                "the results",
                {"series_count": len(wide)},
            )
        )
    return gather_doubts(found)
