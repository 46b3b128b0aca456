"""A store whose writers are killed, and one that two write at once: no result is lost, halved or doubled.

``python benchmarks/survey_kills.py [KILLS [PAIRS]]``, by default 1,000 and 10. Each round a process adds results to a
store, puts a new evaluation in the place of another, or takes one out; it is killed (SIGKILL) at a random moment. Then
the store must hold each result whole or not at all, once, and all that was in it before but the one that was being
taken out. In pairs two processes add some of the same results at the same moment. A fault ends with exit code 1.
"""

import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import duckdb
import numpy as np

from calibration.survey import AddOptions, add, check, remove
from heliogauge.results.folder import Summary, write_summary, write_table_csv

#: Results, and rows of beams in each.
_RESULTS, _BEAMS = 8, 40
#: Rounds with one store before it is made anew.
_ROUNDS = 20
#: What the process of a round does, in turn.
_WORK = ("add three", "evaluate anew", "take out", "add all")


def draw(folder: Path, rng: np.random.Generator, scale: float) -> list[Path]:
    """Write results of beams; another scale is another evaluation of the same measurements."""
    for number in range(_RESULTS):
        out = folder / f"H{number}"
        out.mkdir(parents=True)
        numbers = {"median_d90_m": scale * (1.0 + number), "sigma_median_d90_m": 0.02}
        inputs = {"photo.png": f"{number:064x}"}
        texts = {"date": "2026-06-21"}
        write_summary(
            out / "summary.json", Summary("beam", f"H{number}", numbers, texts, (), {"measure": rng.random()}, inputs)
        )
        times = [f"2026-06-21T{8 + beam // 6:02d}:{beam % 6}0:00Z" for beam in range(_BEAMS)]
        columns = {"time_utc": times, "x_m": scale * rng.normal(size=_BEAMS), "sigma_x_m": np.full(_BEAMS, 0.02)}
        write_table_csv(out / "beams.csv", columns)
    return sorted(folder.iterdir())


def contents(store: Path) -> dict[str, tuple[str, int, float]]:
    """Return of each result of a store its source, the number of rows and the sum of its values; refuse any fault."""
    found = check(store)
    if found.faults:
        raise SystemExit(f"fault: {found.faults[0]}")
    if not found.entries:
        return {}
    files = [str(store / name) if (store / name).exists() else _hidden(store, name) for name in _names(found)]
    rows = duckdb.sql(
        f"SELECT result, any_value(source), count(*), sum(value) FROM read_parquet({files}, hive_partitioning = false) "
        "GROUP BY result"
    ).fetchall()
    if len(rows) != len(found.entries):
        raise SystemExit(f"fault: {len(rows)} results in files, {len(found.entries)} in the manifest")
    return {name: (source, count, round(total, 9)) for name, source, count, total in rows}


def _names(found) -> list[str]:
    return list(dict.fromkeys(file for file, _ in found.entries))


def _hidden(store: Path, name: str) -> str:
    # Where the file of a change stands that took place just before the kill.
    return str(store / "rows" / f".{Path(name).stem}.partial")


def forked(work: Callable[[], None]) -> int:
    """Start work in a process of its own.

    Returns: Its number.
    """
    sys.stdout.flush()
    number = os.fork()
    if number == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    return number


def ended(number: int) -> int:
    """Wait for a process.

    Returns: Its exit code; negative: the signal that ended it.
    """
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


def asked(work: Callable[[], object]) -> object:
    """Return what work in a process of its own returns: threads of DuckDB do not survive a fork."""
    reading, writing = os.pipe()

    def send() -> None:
        os.close(reading)
        with os.fdopen(writing, "w") as pipe:
            pipe.write(repr(work()))

    number = forked(send)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    if ended(number):
        raise SystemExit("fault: see above")
    return eval(text, {"__builtins__": {}})  # what this file wrote itself


def work_of_round(store: Path, first: list[Path], second: list[Path], turn: int) -> None:
    """Do one of four things: add three results, add all, evaluate one anew, take one out."""
    number = turn // len(_WORK) % _RESULTS
    what = _WORK[turn % len(_WORK)]
    if what == "add three":
        add([first[(number + step) % _RESULTS] for step in (0, 3, 5)], store)
    elif what == "add all":
        add(first, store)
    elif what == "evaluate anew":
        add([second[number]], store, AddOptions(force=True))
    else:
        names = [one.result for _, one in check(store).entries if one.source == f"H{number}"]
        remove(store, names)


def kills(count: int, place: Path, rng: np.random.Generator) -> None:
    """Kill a process that writes, many times."""
    first, second = draw(place / "first", rng, 1.0), draw(place / "second", rng, 2.0)
    wanted = dict[str, tuple[str, int, float]]()
    for name, results in (("a", first), ("b", second)):
        whole = place / f"whole_{name}"
        ended(forked(lambda results=results, whole=whole: add(results, whole) and None))
        wanted |= asked(lambda whole=whole: contents(whole))
    longest: list[float] = []
    for turn in range(len(_WORK)):
        begin = time.perf_counter()
        if ended(forked(lambda turn=turn: work_of_round(place / "calm", first, second, turn))):
            raise SystemExit("fault: see above")
        longest.append(time.perf_counter() - begin)
    seen, had = Counter[str](), dict[str, tuple[str, int, float]]()
    for turn in range(count):
        store = place / f"store{turn // _ROUNDS}"
        if turn % _ROUNDS == 0:
            had = {}
        number = forked(lambda turn=turn, store=store: work_of_round(store, first, second, turn))
        time.sleep(rng.uniform(0, longest[turn % len(_WORK)]))
        os.kill(number, signal.SIGKILL)
        code = ended(number)
        if not (store / "store.json").exists():
            seen["no store yet"] += 1
            longest[turn % len(_WORK)] *= 1.03
            continue
        if code not in (0, -signal.SIGKILL):
            raise SystemExit(f"fault: round {turn}: see above")
        seen["killed" if code else "ended before"] += 1
        # One in five ends before, however busy the machine is: kills fall on all of the work, up to its last moments.
        longest[turn % len(_WORK)] *= 1.03 if code else 0.9
        manifest = store / "manifest.jsonl"
        seen["half a line"] += manifest.exists() and not manifest.read_bytes().endswith(b"\n")
        seen["unfinished file"] += any((store / "rows").glob(".*.partial"))
        has = asked(lambda store=store: contents(store))
        for name, content in has.items():
            if wanted.get(name) != content:
                raise SystemExit(f"fault: round {turn}: {content} instead of {wanted.get(name)}")
        sources = Counter(source for source, _, _ in has.values())
        if max(sources.values(), default=0) > 1:
            raise SystemExit(f"fault: round {turn}: doubled: {sources}")
        taken_out = {f"H{turn // len(_WORK) % _RESULTS}"} if _WORK[turn % len(_WORK)] == "take out" else set()
        lost = {source for source, _, _ in had.values()} - set(sources) - taken_out
        if lost:
            raise SystemExit(f"fault: round {turn}: lost: {lost}")
        seen["store changed"] += has != had
        had = has
    print(f"{count} kills: nothing lost, halved or doubled; rounds: {dict(sorted(seen.items()))}")


def pairs(count: int, place: Path, rng: np.random.Generator) -> None:
    """Let two processes add the same results, and others, at the same moment."""
    results = draw(place / "results", rng, 1.0)
    for turn in range(count):
        store = place / f"pair{turn}"
        numbers = [
            forked(lambda store=store, some=some: add(some, store) and None) for some in (results[:6], results[2:])
        ]
        if any(map(ended, numbers)):
            raise SystemExit("fault: see above")
        has = asked(lambda store=store: contents(store))
        if Counter(source for source, _, _ in has.values()) != Counter(one.name for one in results):
            raise SystemExit(f"fault: pair {turn}: {has}")
        if any(rows != _BEAMS + 1 for _, rows, _ in has.values()):
            raise SystemExit(f"fault: pair {turn}: {has}")
    print(f"{count} pairs at once: nothing lost, halved or doubled")


def main() -> None:
    """Kill and pair as often as the command line says."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        begin = time.perf_counter()
        kills(int(sys.argv[1]) if len(sys.argv) > 1 else 1000, place / "kills", rng)
        pairs(int(sys.argv[2]) if len(sys.argv) > 2 else 10, place / "pairs", rng)
        print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
