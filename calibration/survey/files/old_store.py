"""Stores of the first version, without a manifest: their results, to be taken over into a store of now."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calibration.survey.files.manifest import ROWS_FOLDER
from calibration.survey.files.moments import refuse_impossible
from calibration.survey.files.parquet_store import COLUMNS_SQL, connect, explain_query
from calibration.survey.files.result_rows import OWN_COLUMNS, Rows, StoredResult
from heliogauge.errors import InputError
from heliogauge.files.parquet import parquet_rows
from heliogauge.validate import TimeArray

#: Results that are read together; harmless.
_AT_ONCE = 500


def old_results(store: Path) -> Iterator[StoredResult | InputError]:
    """Yield the results of a store of the first version, or why one cannot be taken over.

    Rows that two processes wrote at once are there twice, and taken once. A result of which a killed process wrote a
    part cannot be recognised: it is marked as taken over, and the result itself takes its place when it is added.
    """
    places = []
    for place in sorted((store / ROWS_FOLDER).glob("*.parquet")):
        try:
            with connect() as connection, explain_query(place):
                connection.execute(f"SELECT {COLUMNS_SQL} FROM {parquet_rows([place])} LIMIT 0")
            places.append(place)
        except InputError as error:
            yield error
    if not places:
        return
    with connect() as connection, explain_query(store):
        source = parquet_rows(places)
        names = [name for (name,) in connection.execute(f"SELECT DISTINCT result FROM {source} ORDER BY 1").fetchall()]
        for begin in range(0, len(names), _AT_ONCE):
            chosen = names[begin : begin + _AT_ONCE]
            connection.register("chosen", {"result": np.array(chosen, dtype=object)})
            table = connection.execute(
                f"SELECT DISTINCT {COLUMNS_SQL} FROM {source} SEMI JOIN chosen USING (result) ORDER BY result"
            ).fetchnumpy()
            results = np.asarray(table["result"], dtype=object)
            for name in chosen:
                yield _result(store, name, {one: np.asarray(table[one])[results == name] for one in OWN_COLUMNS})


def _result(
    store: Path, name: str, columns: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]
) -> StoredResult | InputError:
    times: TimeArray = columns["time"].astype("datetime64[us]")
    columns["time"] = times
    source, kind, subject = (str(columns[one][0]) for one in ("source", "kind", "subject"))
    try:
        refuse_impossible(times, f"{store}: result {name[:12]} ({source})")
    except InputError as error:
        return error
    kinds = sorted({str(one).removesuffix("-row") for one in columns["kind"]})
    return StoredResult(Path(source), kinds[0] if kinds else kind, subject, Rows(columns), "", name, taken_over=True)
