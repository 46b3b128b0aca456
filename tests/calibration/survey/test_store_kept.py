"""What a store keeps: each result once and whole, whatever was killed, refused, emptied or put there by others."""

import contextlib
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.files.locks import held
from heliogauge.results.folder import Summary, write_json, write_summary, write_table_csv
from heliogauge.running.progress import SilentProgress

pytest.importorskip("duckdb")

import duckdb

from benchmarks.survey_kills import kills, pairs
from calibration.survey import AddOptions, add, check, remove
from calibration.survey.cli import app
from calibration.survey.files import parquet_store
from calibration.survey.files.manifest import read_manifest
from calibration.survey.files.moments import read_moment
from calibration.survey.files.parquet_store import LOCK_FILE, query, reading
from calibration.survey.pipeline.judge_store import SurveyOptions, run
from calibration.survey.pipeline.keep_store import add_event
from tests.conftest import REPOSITORY


@pytest.fixture(autouse=True)
def no_waiting():
    """What waits for ever fails."""
    signal.alarm(120)
    yield
    signal.alarm(0)


def write_result(folder, name="H01", value=1e-3, sigma=2e-5, inputs=None, kind="beam", texts=None, duration=1.0):
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {"sd_rad": value} | ({} if sigma is None else {"sigma_sd_rad": sigma})
    texts = {"date": "2026-05-01"} if texts is None else texts
    inputs = {} if inputs is None else inputs
    write_summary(folder / "summary.json", Summary(kind, name, numbers, texts, (), {"measure": duration}, inputs))
    return folder


def rows_of(store, columns="value"):
    with query(store) as connection:
        return connection.execute(f"SELECT {columns} FROM rows ORDER BY ALL").fetchall()


# --- what goes in, and when it was measured


def test_report_of_results_without_a_sigma(tmp_path):
    """Calibrations of heliostats have none: the report says so, and lists them."""
    for month in (1, 2, 3):
        write_result(
            tmp_path / "all" / f"r{month}", sigma=None, texts={"date": f"2026-{month:02d}-01"}, value=month * 1e-3
        )
    add([tmp_path / "all"], tmp_path / "store")
    done = CliRunner().invoke(app, ["report", str(tmp_path / "store"), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "report.html").is_file()
    result = run(tmp_path / "store")
    assert result.overview["quantity"] == ["sd_rad"]
    assert result.trends["subject"] == []
    assert [one.code for one in result.doubts] == ["results_without_sigma"]
    chosen = run(tmp_path / "store", SurveyOptions(quantities=("sd_rad",)))
    assert [one.code for one in chosen.doubts] == ["results_without_sigma"]


def write_field(folder):
    """A field without a date, and two heliostats whose rows have times."""
    write_result(folder, "field", sigma=None, kind="heliostat-field", texts={})
    for name, hour in (("H01", 9), ("H02", 15)):
        write_result(folder / name, name, sigma=None, kind="heliostat", texts={})
        table = {
            "time_utc": [f"2025-10-15T{hour:02d}:00:00Z", "2025-03-04T09:00:00.500Z", "2029-01-01T00:00:00Z", ""],
            "reason": ["", "", "outlier", ""],
        }
        write_table_csv(folder / name / "residuals.csv", table)
    return folder


def test_heliostats_carry_the_date_of_their_latest_row_that_was_used(tmp_path):
    added = add([write_field(tmp_path / "field")], tmp_path / "store")
    assert (added.results, added.left_out) == (3, ())
    times = {subject: str(time) for subject, time in rows_of(tmp_path / "store", "subject, time")}
    assert times == {"H01": "2025-10-15 09:00:00", "H02": "2025-10-15 15:00:00", "field": "2025-10-15 15:00:00"}


def test_a_date_is_taken_only_where_the_result_says_none(tmp_path):
    write_result(tmp_path / "all" / "dated")
    write_result(tmp_path / "all" / "undated", "H02", texts={})
    add([tmp_path / "all"], tmp_path / "store", AddOptions(date="2026-06-21"))
    times = {subject: str(time)[:10] for subject, time in rows_of(tmp_path / "store", "subject, time")}
    assert times == {"H01": "2026-05-01", "H02": "2026-06-21"}


def test_one_undated_result_does_not_refuse_the_list(tmp_path):
    for number in range(4):
        write_result(tmp_path / "all" / f"r{number}", f"H{number}", texts={} if number == 1 else None)
    done = CliRunner().invoke(app, ["add", str(tmp_path / "all"), "-o", str(tmp_path / "store")])
    assert done.exit_code == 0, done.output
    assert "3 results, 3 rows added" in done.stdout
    assert "1 left out" in done.stdout
    assert "r1: the result says no date" in done.stderr
    with pytest.raises(InputError, match="says no date"):
        add([tmp_path / "all" / "r1"], tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    "text",
    ["20260101", "NaT", "300000-01-01", "soon", "today", "1899-12-31", "2100-01-01", "2026-13-01", "0001-01-01", ""]
    + ["0001-01-01T00:00:00+02:00", "2026-06", "\u0662026-06-21"],
)
def test_days_that_cannot_be_meant(tmp_path, text):
    result = write_result(tmp_path / "result", texts={})
    with pytest.raises(InputError, match="day"):
        add([result], tmp_path / "store", AddOptions(date=text))
    with pytest.raises(InputError, match="day"):
        add([write_result(tmp_path / "said", texts={"date": text or "-"})], tmp_path / "store")
    add([result], tmp_path / "store", AddOptions(date="2026-06-21"))
    with pytest.raises(InputError, match="day"):
        add_event(tmp_path / "store", "*", text, "cleaned")
    with pytest.raises(InputError, match="day"):
        run(tmp_path / "store", SurveyOptions(since=text))
    write_json(tmp_path / "store" / "events" / "e.json", {"subject": "*", "date": text, "what": "cleaned"})
    with pytest.raises(InputError, match=r"e\.json: date"):
        run(tmp_path / "store")
    assert "e.json" in check(tmp_path / "store").faults[0]


def test_days_that_can():
    moments = {
        "1900-01-01": "1900-01-01T00:00",
        "2099-12-31": "2099-12-31T00:00",
        "2026-06-01 to 2026-06-21": "2026-06-21T00:00",
        "2026-06-21T10:00:00+02:00": "2026-06-21T08:00",
        "2026-06-21 10:00Z": "2026-06-21T10:00",
    }
    assert {text: read_moment(text, "test") for text in moments} == {
        text: np.datetime64(moment, "us") for text, moment in moments.items()
    }


def test_times_of_rows_that_cannot_be_meant(tmp_path):
    result = write_result(tmp_path / "result")
    write_table_csv(result / "beams.csv", {"time_utc": ["9999-01-01T00:00:00Z"], "x_m": [0.5]})
    with pytest.raises(InputError, match=r"beams\.csv: time_utc: days"):
        add([result], tmp_path / "store")


def test_the_report_counts_the_doubts_of_its_results(tmp_path):
    doubts = (
        Doubt("photos_few", "3 photos only", {"photos_count": float("nan")}, Severity.SERIOUS),
        Doubt("photos_copied", "a note", {}, Severity.NOTE),
    )
    for number in range(3):
        summary = Summary("beam", "H01", {"sd_rad": 1e-3 * (1 + number), "sigma_sd_rad": 2e-5}, {"date": "2026-05-01"})
        (tmp_path / "all" / f"r{number}").mkdir(parents=True)
        write_summary(tmp_path / "all" / f"r{number}" / "summary.json", replace(summary, doubts=doubts[: number + 1]))
    write_result(tmp_path / "all" / "sound", value=4e-3, texts={"date": "2026-06-01"})
    add([tmp_path / "all"], tmp_path / "store")
    (found,) = [one for one in run(tmp_path / "store").doubts if one.code == "photos_few"]
    assert (found.numbers, found.severity) == ({"parts_count": 3}, Severity.SERIOUS)
    assert "3 of 4 results" in found.text
    assert "r0, r1, r2" in found.text
    assert "photos_few" not in {one.code for one in run(tmp_path / "store", SurveyOptions(since="2026-06-01")).doubts}


def test_results_until_a_day_end_before_it(tmp_path):
    for day in (1, 2):
        write_result(tmp_path / "all" / f"r{day}", texts={"date": f"2026-05-0{day}"}, value=day * 1e-3)
    add([tmp_path / "all"], tmp_path / "store")
    assert run(tmp_path / "store", SurveyOptions(until="2026-05-02")).counts["results"] == 1


# --- each result once


def test_the_same_measurement_evaluated_again_counts_once(tmp_path):
    photos = {"measurement.toml": "0" * 64, "a.png": "1" * 64}
    store = tmp_path / "store"
    add([write_result(tmp_path / "first", inputs=photos)], store)
    # Durations and places differ, numbers do not.
    assert add([write_result(tmp_path / "b", inputs=photos, duration=2.0)], store).known == (tmp_path / "b",)
    # Settings were corrected: other numbers of the same photos.
    corrected = photos | {"measurement.toml": "2" * 64}
    other = write_result(tmp_path / "c", value=1.1e-3, inputs=corrected)
    added = add([other], store)
    assert (added.results, len(added.again)) == (0, 1)
    assert rows_of(store) == [(1e-3,)]
    done = CliRunner().invoke(app, ["add", str(other), "-o", str(store)])
    assert "the same measurement is in the store" in done.stderr
    added = add([other], store, AddOptions(force=True))
    assert (added.results, len(added.replaced)) == (1, 1)
    assert rows_of(store) == [(1.1e-3,)]
    assert check(store).faults == ()
    # Other photos, or another mirror on them, are other measurements.
    add([write_result(tmp_path / "d", inputs={"a.png": "3" * 64})], store)
    add([write_result(tmp_path / "e", "H02", value=1.1e-3, inputs=corrected)], store)
    assert rows_of(store, "subject, value") == [("H01", 1e-3), ("H01", 1.1e-3), ("H02", 1.1e-3)]
    with pytest.raises(InputError, match="there is no such folder"):
        add([tmp_path / "nothing", other], store)


def test_two_evaluations_in_one_call_count_once(tmp_path):
    for number, value in enumerate((1e-3, 1.1e-3)):
        write_result(tmp_path / "all" / f"r{number}", value=value, inputs={"a.png": "1" * 64})
    added = add([tmp_path / "all"], tmp_path / "one")
    assert (added.results, len(added.again)) == (1, 1)
    assert rows_of(tmp_path / "one") == [(1e-3,)]
    assert add([tmp_path / "all"], tmp_path / "two", AddOptions(force=True)).results == 1
    assert rows_of(tmp_path / "two") == [(1.1e-3,)]


def test_the_same_folders_forced_again_change_nothing(tmp_path):
    """Two evaluations of one measurement lie in the folders: the later one stays, however often it is put in."""
    folders, store, options = tmp_path / "all", tmp_path / "store", AddOptions(force=True)
    for number, value in enumerate((1e-3, 1.1e-3)):
        write_result(folders / f"r{number}", value=value, inputs={"a.png": "1" * 64})
    added = add([folders], store, options)
    assert (added.results, len(added.replaced), [one.name for one, _ in added.again]) == (1, 0, ["r0"])
    added = add([folders], store, options)
    assert (added.results, added.replaced, added.known) == (0, (), (folders / "r1",))
    write_result(folders / "r2", "H02", value=3e-3, inputs={"b.png": "2" * 64})
    added = add([folders], store, options)
    assert ([one.name for one, _ in added.added], added.replaced, added.known) == (["r2"], (), (folders / "r1",))
    assert rows_of(store, "subject, value") == [("H01", 1.1e-3), ("H02", 3e-3)]
    # A later evaluation takes the place of what is in the store; the earlier ones do not come back.
    write_result(folders / "r3", value=1.2e-3, inputs={"a.png": "1" * 64})
    added = add([folders], store, options)
    assert [one.name for one, _ in added.replaced] == ["r3"]
    assert rows_of(store, "subject, value") == [("H01", 1.2e-3), ("H02", 3e-3)]
    done = CliRunner().invoke(app, ["add", str(folders), "-o", str(store), "--force"])
    assert done.stdout.startswith("0 results, 0 rows added")
    assert done.stderr.count("the later folder of this command is kept") == 2
    assert "--force" not in done.stderr
    assert check(store).faults == ()


def test_nothing_stays_of_a_result_that_is_refused(tmp_path):
    """The table behind the summary's numbers holds a word: no row of the result, and the others are whole."""
    good = write_result(tmp_path / "all" / "a")
    bad = write_result(tmp_path / "all" / "b", "H02")
    columns = {"time_utc": ["2026-05-01T10:00:00Z"] * 2, "x_m": ["0.5", "many"]}
    write_table_csv(bad / "beams.csv", columns)
    added = add([tmp_path / "all"], tmp_path / "store")
    assert [folder for folder, _ in added.added] == [good]
    ((folder, reason),) = added.left_out
    assert folder == bad
    assert "beams.csv: column x_m must hold numbers" in reason
    assert rows_of(tmp_path / "store", "subject") == [("H01",)]
    columns["x_m"][1] = "0.6"
    write_table_csv(bad / "beams.csv", columns)
    assert add([tmp_path / "all"], tmp_path / "store").rows == 3
    for name in ("value", "sigma"):
        entries = {
            "heliostat": ["H02"],
            "test": ["drift"],
            "key": ["x_m"],
            "value": ["1"],
            "sigma": ["1"],
            "date": [""],
        }
        write_table_csv(bad / "entries.csv", entries | {name: ["many"]})
        with pytest.raises(InputError, match=rf"entries\.csv: column {name} must hold numbers"):
            add([bad], tmp_path / "store")


# --- names and files that mean something to others


@pytest.mark.parametrize(
    ("name", "meant"), [("value=9", "x"), ("a*b", "aXb"), ("p[la]n", "pln"), ("what?", "whatX"), ("it's", "x")]
)
def test_names_of_folders_mean_nothing(tmp_path, name, meant):
    store = tmp_path / name / "store"
    add([write_result(tmp_path / "r1")], store)
    # The same files where the signs would lead.
    shutil.copytree(tmp_path / name, tmp_path / meant)
    add([write_result(tmp_path / "r2", value=2e-3)], store)
    assert rows_of(store) == [(1e-3,), (2e-3,)]
    remove(store, [check(store).entries[0][1].result])
    assert rows_of(store) == [(2e-3,)]


def stored(tmp_path):
    """Return a store of three results in two files, and the files."""
    store = tmp_path / "store"
    first = [write_result(tmp_path / "r0", "H00", 1e-3), write_result(tmp_path / "r1", "H01", 2e-3)]
    add(first, store)
    add([write_result(tmp_path / "r2", "H02", 3e-3)], store)
    return store, [store / name for name in dict.fromkeys(file for file, _ in check(store).entries)]


def damage(path, how):
    content = path.read_bytes()
    path.unlink()
    if how == "emptied":
        path.write_bytes(b"")
    elif how == "changed":
        path.write_bytes(content[:20] + bytes([content[20] ^ 1]) + content[21:])
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "link":
        path.symlink_to("/dev/zero")


@pytest.mark.parametrize("how", ["emptied", "changed", "missing", "pipe", "link"])
def test_damaged_files_are_named_and_taken_out(tmp_path, how):
    store, (first, _) = stored(tmp_path)
    damage(first, how)
    words = {"pipe": "pipe", "link": "device"}.get(how, how)
    with pytest.raises(InputError, match=f"{first.name}: .*{words}"):
        run(store)
    done = CliRunner().invoke(app, ["check", str(store)])
    assert done.exit_code == 2
    assert words in done.stderr
    assert "it held 2 results" in done.stderr
    (name,) = [entry.result for _, entry in check(store).entries if entry.subject == "H00"]
    with pytest.raises(InputError, match="remove all of it"):
        remove(store, [name])
    done = CliRunner().invoke(app, ["remove", str(store), f"rows/{first.name}"])
    assert done.exit_code == 0, done.output
    assert "2 results, 2 rows removed" in done.stdout
    assert rows_of(store) == [(3e-3,)]
    assert CliRunner().invoke(app, ["check", str(store)]).exit_code == 0
    assert add([tmp_path / "r0", tmp_path / "r1"], store).results == 2


def test_foreign_files_do_not_count_and_are_named(tmp_path, capsys):
    store, (first, _) = stored(tmp_path)
    shutil.copy(first, store / "rows" / "copy.parquet")
    os.mkfifo(store / "rows" / "wait.parquet")
    assert len(rows_of(store)) == 3
    done = CliRunner().invoke(app, ["report", str(store), "-o", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 0
    assert "copy.parquet is not in the manifest" in done.stderr
    found = check(store)
    assert found.faults == ()
    assert [note.split(":")[0] for note in found.notes] == ["rows/copy.parquet", "rows/wait.parquet"]


@pytest.mark.parametrize("name", ["manifest.jsonl", "store.lock", "store.json", "events/x.json"])
def test_pipes_are_not_opened(tmp_path, name):
    store, _ = stored(tmp_path)
    (store / name).unlink(missing_ok=True)
    os.mkfifo(store / name)
    if name != "store.lock":
        with pytest.raises(InputError, match="pipe"):
            run(store)
    if name != "events/x.json":
        with pytest.raises(InputError, match=r"pipe|no regular file"):
            add([write_result(tmp_path / "r3", "H03")], store)


@pytest.mark.parametrize(
    "line", ["[]", "{}", '{"file": "../x.parquet", "sha256": "", "results": [], "replaces": []}', "\x00\x00", "\xff"]
)
def test_a_damaged_manifest_is_named(tmp_path, line):
    store, _ = stored(tmp_path)
    with (store / "manifest.jsonl").open("ab") as file:
        file.write(line.encode("latin-1") + b"\n")
    with pytest.raises(InputError, match=r"manifest\.jsonl, line 3"):
        run(store)


# --- what is interrupted


def test_half_a_line_and_unfinished_files_do_not_count(tmp_path):
    store, (first, _) = stored(tmp_path)
    with (store / "manifest.jsonl").open("ab") as file:
        file.write(b'{"file": "rows/')
    (store / "rows" / f".{'0' * 32}.partial").write_bytes(b"PAR1")
    # A change that took place, killed before its file had its name.
    hidden = store / "rows" / f".{first.stem}.partial"
    first.rename(hidden)
    assert rows_of(store) == [(1e-3,), (2e-3,), (3e-3,)]
    assert check(store).faults == ()
    assert "killed" in check(store).notes[0]
    assert add([write_result(tmp_path / "r3", "H03", 4e-3)], store).results == 1
    assert first.is_file()
    assert list((store / "rows").glob(".*")) == []
    assert check(store).notes == ()
    assert len(rows_of(store)) == 4


def test_killed_and_in_pairs_nothing_is_lost_or_doubled(tmp_path, capfd):
    kills(6, tmp_path / "kills", np.random.default_rng(1))
    pairs(2, tmp_path / "pairs", np.random.default_rng(2))
    assert "2 pairs at once: nothing lost" in capfd.readouterr().out


@pytest.mark.slow
def test_many_kills_lose_and_double_nothing(tmp_path, capfd):
    signal.alarm(600)
    kills(100, tmp_path / "kills", np.random.default_rng(3))
    pairs(10, tmp_path / "pairs", np.random.default_rng(4))
    assert "10 pairs at once: nothing lost" in capfd.readouterr().out


def test_a_lock_is_waited_for_and_a_left_one_is_not(tmp_path):
    lock = tmp_path / LOCK_FILE
    lock.write_text(json.dumps({"process": 1, "machine": "elsewhere", "since": "2026-01-01"}) + "\n")
    with held(lock, 0.0):
        process = subprocess.run(
            [sys.executable, "-c", "import sys; from pathlib import Path; from heliogauge.files.locks import held\n"
             "with held(Path(sys.argv[1]), 0.1): pass", str(lock)],
            capture_output=True, text=True, check=False, cwd=REPOSITORY,
        )  # fmt: skip
        assert f"process {os.getpid()} on" in process.stderr
    with held(lock, 0.0):
        assert json.loads(lock.read_text())["process"] == os.getpid()


def test_a_full_disk_is_one_message_and_leaves_the_store_as_it_was(tmp_path):
    store, _ = stored(tmp_path)
    before = {path: path.read_bytes() for path in store.rglob("*") if path.is_file() and path.name != LOCK_FILE}
    result = write_result(tmp_path / "large", "H09")
    rng = np.random.default_rng(0)
    times = [f"2026-05-01T10:00:{second % 60:02d}Z" for second in range(20000)]
    write_table_csv(result / "beams.csv", {"time_utc": times, "x_m": rng.normal(size=20000)})
    done = subprocess.run(
        [sys.executable, "-m", "heliogauge", "survey", "add", str(result), "-o", str(store), "-q"],
        capture_output=True,
        text=True,
        check=False,
        cwd=REPOSITORY,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"heliogauge: {store}: cannot be written (")
    assert done.stderr.count("\n") == 1
    after = {path: path.read_bytes() for path in store.rglob("*") if path.is_file() and path.name != LOCK_FILE}
    assert after == before


def test_a_store_that_cannot_be_written_says_so():
    """As another user, since the tests may run as root; reading and checking go on."""
    place = Path(tempfile.mkdtemp())
    try:
        place.chmod(0o755)
        store, _ = stored(place)
        closed = write_result(place / "closed" / "result").parent
        closed.chmod(0)
        reading, writing = os.pipe()
        number = os.fork()
        if number == 0:
            texts = []
            if os.getuid() == 0:
                os.setuid(65534)
            for path in (store / "rows", store / "events", store / "store.lock", store / "manifest.jsonl", store):
                if path.stat().st_uid == os.getuid():
                    path.chmod(path.stat().st_mode & 0o555)
            every = [
                lambda: add([place / "r0"], store),
                lambda: add_event(store, "*", "2026-01-01", "cleaned"),
                lambda: add([closed / "result"], store),
                lambda: add([place / "r0"], closed / "store"),
                lambda: run(closed / "store"),
                lambda: check(closed / "store"),
                lambda: remove(closed / "store", ["123456"]),
            ]
            for work in every:
                try:
                    work()
                    texts.append("no error")
                except InputError as error:
                    texts.append(f"{error}")
            texts.append(repr(check(store).faults))
            os.write(writing, "\n".join(texts).encode())
            os._exit(0)
        os.waitpid(number, 0)
        added, noted, *refused, faults = os.read(reading, 10_000).decode().splitlines()
        assert added.startswith(f"{store / LOCK_FILE}: cannot be written (Permission denied)")
        assert noted.startswith(f"{store / 'events'}: cannot be written (")
        assert len(refused) == 5
        assert all(text.startswith(str(closed)) and "Permission denied" in text for text in refused)
        assert faults == "()"
        with pytest.raises(InputError, match="cannot be made"):
            add([place / "r0"], Path("/proc/store"))
    finally:
        subprocess.run(["chmod", "-R", "u+rwx", str(place)], check=True)
        shutil.rmtree(place)


# --- reading beside a process that writes


def read_while_it_changes(store, change, monkeypatch):
    """Return what a report counts when another process changes the store as soon as its manifest was read."""
    begun = []

    def slow(folder):
        manifest = read_manifest(folder)
        if not begun:
            begun.append(subprocess.Popen([sys.executable, "-m", "heliogauge", "survey", *map(str, change)]))
            # Long enough for the other process to be done, were it not kept waiting.
            with contextlib.suppress(subprocess.TimeoutExpired):
                begun[0].wait(3)
        return manifest

    monkeypatch.setattr(parquet_store, "read_manifest", slow)
    said = []
    progress = SilentProgress()
    monkeypatch.setattr(SilentProgress, "say", lambda self, text: said.append(text))
    counts = run(store, None, progress).counts
    assert begun[0].wait(60) == 0
    return counts, said


def test_a_report_beside_a_writer_reads_the_store_as_it_was(tmp_path, monkeypatch):
    store, _ = stored(tmp_path)
    inputs = {"a.png": "1" * 64}
    add([write_result(tmp_path / "first", "H03", 4e-3, inputs=inputs)], store)
    other = write_result(tmp_path / "again", "H03", 5e-3, inputs=inputs)
    names = {entry.subject: entry for _, entry in check(store).entries}
    counts, said = read_while_it_changes(store, ["remove", store, names["H01"].result, "-q"], monkeypatch)
    assert (counts["results"], said) == (4, [])
    counts, said = read_while_it_changes(store, ["add", other, "-o", store, "--force", "-q"], monkeypatch)
    assert (counts["results"], said) == (3, [])
    assert rows_of(store) == [(1e-3,), (3e-3,), (5e-3,)]
    assert check(store).faults == ()


def test_readers_do_not_wait_for_each_other_but_for_a_writer(tmp_path, monkeypatch):
    store, _ = stored(tmp_path)
    monkeypatch.setattr(parquet_store, "WAIT_S", 0.2)
    before = (store / LOCK_FILE).read_bytes()
    with reading(store), reading(store):
        assert check(store).faults == ()
        with pytest.raises(InputError, match="another process keeps it"):
            remove(store, ["123456"])
    assert (store / LOCK_FILE).read_bytes() == before
    with held(store / LOCK_FILE, 0.0):
        for work in (run, check):
            with pytest.raises(InputError, match=f"another process keeps it.*process {os.getpid()} on"):
                work(store)
    # A copy without the file of the lock can be read.
    (store / LOCK_FILE).unlink()
    assert run(store).counts["results"] == 3
    assert check(store).faults == ()


# --- commands


def test_check_lists_and_remove_takes_out(tmp_path):
    store, _ = stored(tmp_path)
    done = CliRunner().invoke(app, ["check", str(store), "--json"])
    content = json.loads(done.stdout)
    assert (content["results_count"], content["rows_count"], content["faults"]) == (3, 3, [])
    names = {one["subject"]: one["result"] for one in content["results"]}
    assert f"{names['H01'][:12]}  H01" in CliRunner().invoke(app, ["check", str(store), "-v"]).stdout
    done = CliRunner().invoke(app, ["remove", str(store), names["H01"][:8], "--json"])
    assert json.loads(done.stdout)["removed"] == [{"result": names["H01"], "subject": "H01", "source": "r1"}]
    assert rows_of(store, "subject, value, sigma") == [("H00", 1e-3, 2e-5), ("H02", 3e-3, 2e-5)]
    assert check(store).faults == ()
    assert len(list((store / "rows").iterdir())) == 2
    for name, words in (
        ("H02", "six digits"),
        (names["H01"], "no results of the store begin so"),
        ("00", "six digits"),
    ):
        with pytest.raises(InputError, match=words):
            remove(store, [name])
    remove(store, [names["H00"], names["H02"]])
    with pytest.raises(InputError, match="the store is empty"):
        run(store)
    assert add([tmp_path / "r0"], store).results == 1


def test_what_came_of_add_and_event_as_json(tmp_path):
    write_result(tmp_path / "all" / "a")
    write_result(tmp_path / "all" / "b", "H02", texts={})
    words = ["add", str(tmp_path / "all"), "--to", str(tmp_path / "store"), "--json"]
    content = json.loads(CliRunner().invoke(app, words).stdout)
    assert (content["results_count"], content["rows_count"]) == (1, 1)
    assert [one["folder"] for one in content["added"]] == [str(tmp_path / "all" / "a")]
    assert "says no date" in content["left_out"][0]["reason"]
    assert json.loads(CliRunner().invoke(app, words).stdout)["known"] == [str(tmp_path / "all" / "a")]
    event = ["event", str(tmp_path / "store"), "--subject", "H*", "--date", "2026-01-01", "--what", "cleaned", "--json"]
    assert [json.loads(CliRunner().invoke(app, event).stdout)["is_new"] for _ in range(2)] == [True, False]
    assert len(list((tmp_path / "store" / "events").iterdir())) == 1


# --- stores of the first version


def old_store(tmp_path):
    """A store without a manifest: a whole result, half of one, one that two processes wrote at once; an event."""
    old = tmp_path / "old"
    connection = duckdb.connect()
    for name in ("rows", "events"):
        (old / name).mkdir(parents=True)
    write_json(old / "store.json", {"software": "heliogauge", "schema_version": 1, "columns": []})
    write_json(old / "events" / "e.json", {"subject": "H*", "date": "2026-05-02", "what": "cleaned"})
    (old / "rows" / "empty.parquet").write_bytes(b"")
    for number in range(3):
        folder = write_result(tmp_path / "r" / f"r{number}", f"H{number}", (number + 1) * 1e-3)
        times = ["2026-05-01T10:00:00Z", "2026-05-01T11:00:00Z"]
        write_table_csv(folder / "beams.csv", {"time_utc": times, "x_m": [0.5, 0.6], "sigma_x_m": [0.02, 0.02]})
        name = hashlib.sha256((folder / "summary.json").read_bytes()).hexdigest()
        values = [
            f"('H{number}', '', 'beam', 'sd_rad', {(number + 1) * 1e-3}::DOUBLE, 2e-5::DOUBLE, TIMESTAMP '2026-05-01')",
            f"('H{number}', '', 'beam-row', 'beams_x_m', 0.5::DOUBLE, 0.02::DOUBLE, TIMESTAMP '2026-05-01 10:00')",
            f"('H{number}', '', 'beam-row', 'beams_x_m', 0.6::DOUBLE, 0.02::DOUBLE, TIMESTAMP '2026-05-01 11:00')",
        ]
        rows = ", ".join(values[:1] if number == 1 else values)
        for copy in range(2 if number == 2 else 1):
            connection.execute(
                f"COPY (SELECT *, 'r{number}' AS source, '{name}' AS result FROM (VALUES {rows}) AS t(subject, part, "
                f"kind, quantity, value, sigma, time)) TO '{old / 'rows' / f'{number}{copy}.parquet'}' (FORMAT parquet)"
            )
    return old


@pytest.mark.parametrize("folders_first", [True, False])
def test_an_old_store_is_taken_over(tmp_path, folders_first):
    old, new = old_store(tmp_path), tmp_path / "new"
    before = {path: path.read_bytes() for path in old.rglob("*") if path.is_file()}
    for work in (lambda: run(old), lambda: check(old), lambda: add([tmp_path / "r"], old)):
        with pytest.raises(InputError, match=f"survey add {old} -o NEW"):
            work()
    if folders_first:
        add([tmp_path / "r"], new)
        assert add([old], new).results == 0
    else:
        added = add([old], new)
        assert (added.results, added.rows) == (3, 3 + 1 + 3)
        assert "empty.parquet" in added.left_out[0][1]
        # The result itself takes the place of the half of it.
        added = add([tmp_path / "r"], new)
        assert [folder.name for folder, _ in added.replaced] == ["r1"]
        assert len(added.known) == 2
    assert len(rows_of(new)) == 9
    assert check(new).faults == ()
    assert check(new).events == 1
    assert {path: path.read_bytes() for path in old.rglob("*") if path.is_file()} == before
