"""Many measurement folders: found and named, failures as rows, taken up again, the same numbers wherever made."""

import csv
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import heliogauge as hg
from heliogauge.batch.batch_folder import JOURNAL_FILE, BatchFolder
from heliogauge.batch.folders import unique_names
from heliogauge.batch.inputs import input_digest
from heliogauge.batch.measure import measure_batch
from heliogauge.errors import EstimationError, InputError
from heliogauge.running.progress import SilentProgress
from heliogauge.running.scale import Workers

HERE = Workers(jobs=1)


@pytest.fixture(scope="session")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurements of one heliostat, of the same name in folders of two days."""
    place = tmp_path_factory.mktemp("batch")
    field = hg.synth("heliostat", place / "all", seed=1)
    for number, day in enumerate(("monday", "tuesday"), start=1):
        only_one(field, f"H0{number}", place / "days" / day / "field")
    return place / "days"


def only_one(field: Path, heliostat: str, folder: Path) -> None:
    """Copy the tables of one heliostat of a field."""
    folder.mkdir(parents=True)
    shutil.copy(field / "measurement.toml", folder)
    for name in ("heliostats.csv", "observations.csv"):
        lines = (field / name).read_text(encoding="utf-8").splitlines(keepends=True)
        kept = [line for line in lines if line.startswith(("heliostat,", f"{heliostat},"))]
        (folder / name).write_text("".join(kept), encoding="utf-8")


@pytest.fixture
def days(pair: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pair, tmp_path / "days"))


def measure(folder: Path, out: Path, workers: Workers = HERE, *, force: bool = False, report: bool = False) -> Any:
    return measure_batch([folder], out, workers, SilentProgress(), {"thorough": False}, force=force, report=report)


def index(out: Path) -> dict[str, dict[str, str]]:
    with (out / "index.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def numbers(out: Path) -> dict[str, Any]:
    """All numbers of all results, to the last bit."""
    return {
        file.relative_to(out).as_posix(): json.loads(file.read_text(encoding="utf-8"))["numbers"]
        for file in sorted(out.glob("*/**/summary.json"))
    }


def made(out: Path) -> dict[str, int]:
    return {file.parent.name: file.stat().st_mtime_ns for file in out.glob("*/summary.json")}


class TestOneRun:
    @pytest.fixture(scope="class")
    def out(self, pair: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
        place = tmp_path_factory.mktemp("once")
        folder = Path(shutil.copytree(pair, place / "days"))
        (folder / "broken").mkdir()
        (folder / "broken" / "measurement.toml").write_text('kind = "heliostatt"\n', encoding="utf-8")
        (folder / "notes").mkdir()
        measure(folder, place / "out", report=True)
        return place / "out"

    def test_every_measurement_has_a_row(self, out: Path) -> None:
        rows = index(out)
        assert list(rows) == ["broken", "monday_field", "tuesday_field"]
        assert [row["status"] for row in rows.values()] == ["failed", "measured", "measured"]
        assert "did you mean" in rows["broken"]["reason"]
        assert (out / rows["monday_field"]["link"]).is_file()

    def test_the_index_has_the_numbers_of_the_results(self, out: Path) -> None:
        row = index(out)["monday_field"]
        summary = hg.open(out / "monday_field").summary
        shown = {key: float(row[key]) for key in summary if row.get(key)}
        assert shown
        assert shown == {key: summary[key] for key in shown}

    def test_the_whole_is_a_result(self, out: Path) -> None:
        result = hg.open(out)
        assert result.summary["failed_count"] == 1
        assert next(one.code for one in result.doubts) == "measurements_failed"
        assert list(result.parts) == ["monday_field", "tuesday_field"]

    def test_its_report_leads_to_the_others(self, out: Path) -> None:
        page = (out / "report.html").read_text(encoding="utf-8")
        assert 'href="tuesday_field/report.html"' in page
        assert "did you mean" in page
        assert "1 of 3 measurements failed" in page


def test_only_what_changed_is_measured_again(days: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure(days, out)
    first = made(out)
    assert measure(days, out).resumed == 2
    assert made(out) == first

    with (days / "monday" / "field" / "measurement.toml").open("a", encoding="utf-8") as file:
        file.write("\n# looked at again\n")
    assert measure(days, out).resumed == 1
    assert made(out)["tuesday_field"] == first["tuesday_field"]
    assert made(out)["monday_field"] != first["monday_field"]

    assert measure(days, out, force=True).resumed == 0
    assert made(out)["tuesday_field"] != first["tuesday_field"]


def test_reports_that_are_asked_for_later_are_made(days: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure(days, out, report=False)
    assert "tuesday_field/summary.json" in (out / "index.csv").read_text(encoding="utf-8")
    first = made(out)
    assert measure(days, out, report=True).resumed == 2
    assert made(out) == first
    assert (out / "tuesday_field" / "report.html").is_file()
    assert "tuesday_field/report.html" in (out / "index.csv").read_text(encoding="utf-8")


def test_other_options_measure_again(days: Path, tmp_path: Path) -> None:
    measure(days / "monday", tmp_path / "out")
    again = measure_batch([days / "monday"], tmp_path / "out", HERE, SilentProgress(), {"only": "H01"}, report=False)
    assert again.resumed == 0


def test_what_fails_now_leaves_no_old_numbers(days: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure(days, out)
    (days / "monday" / "field" / "measurement.toml").write_text("kind = 3\n", encoding="utf-8")
    measure(days, out)
    assert index(out)["monday_field"]["status"] == "failed"
    assert not (out / "monday_field").exists()


def test_results_of_another_folder_are_not_replaced(days: Path, tmp_path: Path) -> None:
    measure(days / "monday", tmp_path / "out")
    with pytest.raises(InputError, match=r"holds the results of .*monday.field, not of .*tuesday.field"):
        measure(days / "tuesday", tmp_path / "out")


def test_a_moved_folder_is_the_same(days: Path, tmp_path: Path) -> None:
    measure(days, tmp_path / "out")
    days.rename(tmp_path / "elsewhere")
    again = measure(tmp_path / "elsewhere", tmp_path / "out")
    assert again.resumed == 2
    assert {row["folder"] for row in again.rows} == {
        str(tmp_path / "elsewhere" / day / "field") for day in ("monday", "tuesday")
    }


def test_when_all_fail_the_index_has_the_reasons(tmp_path: Path) -> None:
    (tmp_path / "in" / "a").mkdir(parents=True)
    (tmp_path / "in" / "a" / "measurement.toml").write_text("kind = 1\n", encoding="utf-8")
    with pytest.raises(EstimationError, match=r"all 1 measurements failed; the first: .*kind = 1"):
        measure(tmp_path / "in", tmp_path / "out")
    assert index(tmp_path / "out")["a"]["status"] == "failed"


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (lambda place: None, "there is no such folder"),
        (lambda place: place.write_text("", encoding="utf-8"), "is a file"),
        (lambda place: place.mkdir(), "no folder with measurement.toml is there"),
    ],
)
def test_folders_that_cannot_be_meant(tmp_path: Path, prepare: Callable[[Path], Any], said: str) -> None:
    prepare(tmp_path / "in")
    with pytest.raises(InputError, match=said):
        measure(tmp_path / "in", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_with_something_else_is_left_alone(days: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "photo.jpg").touch()
    with pytest.raises(InputError, match="holds files that are no results"):
        measure(days, tmp_path / "out", force=True)
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["photo.jpg"]


def test_names_are_told_apart_on_every_disk() -> None:
    folders = [Path("/a/x/Facet"), Path("/a/y/facet"), Path("/b/x/facet"), Path("/c/.hidden"), Path("/c/index.csv")]
    assert unique_names(folders, ["index.csv"]) == ["a_x_Facet", "y_facet", "b_x_facet", "hidden", "c_index.csv"]
    assert unique_names([Path("/x"), Path("/X")]) == ["x", "X_2"]


def test_the_digest_is_of_contents(days: Path, tmp_path: Path) -> None:
    folder = days / "monday" / "field"
    digest = input_digest(folder, {})
    assert input_digest(Path(shutil.copytree(folder, tmp_path / "copy")), {}) == digest
    assert input_digest(folder, {"jobs": 3}) != digest
    (folder / ".hidden").write_text("x", encoding="utf-8")
    assert input_digest(folder, {}) == digest
    (folder / "more.txt").write_text("x", encoding="utf-8")
    assert input_digest(folder, {}) != digest


def test_files_elsewhere_that_are_named_count(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "measurement.toml").write_text('like = "../earlier"\n', encoding="utf-8")
    (tmp_path / "earlier").mkdir()
    (tmp_path / "earlier" / "a.csv").write_text("1", encoding="utf-8")
    digest = input_digest(tmp_path / "in", {})
    (tmp_path / "earlier" / "a.csv").write_text("2", encoding="utf-8")
    assert input_digest(tmp_path / "in", {}) != digest


def test_files_elsewhere_that_a_pattern_names_count(tmp_path: Path) -> None:
    for name in ("in", "photos"):
        (tmp_path / name).mkdir()
    (tmp_path / "in" / "measurement.toml").write_text('name = ".."\nfiles = "../photos/*.png"\n', encoding="utf-8")
    (tmp_path / "photos" / "1.png").write_text("one", encoding="utf-8")
    digest = input_digest(tmp_path / "in", {})
    (tmp_path / "beside.txt").write_text("no input", encoding="utf-8")
    assert input_digest(tmp_path / "in", {}) == digest
    (tmp_path / "photos" / "2.png").write_text("two", encoding="utf-8")
    assert input_digest(tmp_path / "in", {}) != digest


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a pipe in the file system is needed")
def test_a_file_too_large_to_read_is_told_by_size_and_time(tmp_path: Path) -> None:
    before = input_digest(tmp_path, {})
    with (tmp_path / "film.mp4").open("wb") as film:
        film.truncate(2**42)
    with_film = input_digest(tmp_path, {})
    assert with_film not in {before, input_digest(tmp_path, {"jobs": 2})}
    os.utime(tmp_path / "film.mp4", (1, 1))
    assert input_digest(tmp_path, {}) != with_film


def test_a_pipe_among_the_files_stops_nothing(tmp_path: Path) -> None:
    before = input_digest(tmp_path, {})
    os.mkfifo(tmp_path / "pipe")
    assert input_digest(tmp_path, {}) == before


def test_half_a_line_of_the_journal_costs_its_measurement_alone(days: Path, tmp_path: Path) -> None:
    measure(days, tmp_path / "out")
    journal = tmp_path / "out" / JOURNAL_FILE
    journal.write_text(journal.read_text(encoding="utf-8")[:-40], encoding="utf-8")
    assert measure(days, tmp_path / "out").resumed == 1


class Said(SilentProgress):
    """Keeps the lines for the person who waits."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)


def test_what_a_power_cut_emptied_or_changed_is_measured_again(days: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure(days, out)
    whole = numbers(out)
    (out / "monday_field" / "summary.json").write_bytes(b"")
    table = out / "tuesday_field" / "residuals.csv"
    content = table.read_bytes()
    table.write_bytes(b"\0" * len(content))
    said = Said()
    result = measure_batch([days], out, HERE, said, {"thorough": False}, report=False)
    assert result.resumed == 0
    assert numbers(out) == whole
    assert table.read_bytes() == content
    size = (out / "monday_field" / "summary.json").stat().st_size
    assert said.lines[0].startswith("monday_field: measured again: summary.json holds 0 of its ")
    assert int(said.lines[0].split()[-2]) == pytest.approx(size, rel=0.01)
    assert said.lines[1] == "tuesday_field: measured again: residuals.csv has another content"
    # What a person adds, and the report that is made at any time, are no part of it.
    (out / "monday_field" / "notes.txt").write_text("by hand", encoding="utf-8")
    (out / "monday_field" / "report.html").write_text("", encoding="utf-8")
    assert measure(days, out).resumed == 2


def test_a_spoiled_result_of_another_folder_is_left_out_and_said(days: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure(days, out)
    (out / "monday_field" / "summary.json").unlink()
    said = Said()
    measure_batch([days / "tuesday"], out, HERE, said, {"thorough": False}, report=False)
    assert said.lines == [
        "monday_field: left out of index.csv until its folder is given again: summary.json is not there"
    ]
    assert "monday_field" not in index(out)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="names of open files are needed")
def test_the_journal_says_finished_when_the_disk_has_all(
    days: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model of the disk: it holds what was waited for, as it was then; names, where the folder was waited for."""
    out = tmp_path / "out"
    on_disk: dict[Path, bytes] = {}
    folders: set[Path] = set()
    fulls: list[int] = []
    wait = os.fsync

    def recorded(number: int) -> None:
        wait(number)
        path = Path(os.readlink(f"/proc/self/fd/{number}"))
        if path.is_dir():
            folders.add(path)
            return
        on_disk[path] = path.read_bytes()
        if path.name == JOURNAL_FILE:
            # What a power cut at this moment leaves: every part that the journal has must be whole.
            for line in on_disk[path].decode().splitlines():
                name, files = json.loads(line)["name"], json.loads(line)["files"]
                assert {out / name, out} <= folders
                assert {file: size for file, (size, _) in files.items()} == {
                    file: len(on_disk.get(out / name / file, b"")) for file in files
                }
                fulls.append(len(files))

    monkeypatch.setattr(os, "fsync", recorded)
    measure(days, out)
    assert len(fulls) == 1 + 2
    assert min(fulls) >= 3
    # The line is not even handed to the system before: it may write it at any time.
    first = list(on_disk)
    assert first.index(out / JOURNAL_FILE) > first.index(out / "monday_field" / "summary.json")


@pytest.mark.slow
def test_ctrl_c_costs_nothing_where_the_journal_was_lost(days: Path, tmp_path: Path) -> None:
    measure(days, tmp_path / "out")
    (tmp_path / "out" / JOURNAL_FILE).unlink()
    (tmp_path / "out" / "notes.txt").write_text("by hand", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt), BatchFolder(tmp_path / "out"):
        raise KeyboardInterrupt
    assert {"summary.json", "notes.txt"} < {one.name for one in (tmp_path / "out").iterdir()}
    assert (tmp_path / "out" / "monday_field" / "summary.json").is_file()


def test_ctrl_c_keeps_what_is_finished(days: Path, tmp_path: Path) -> None:
    class Stopping(SilentProgress):
        def advanced(self, stage: Any) -> None:
            if stage.name == "measure folders":
                raise KeyboardInterrupt

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt, match="1 of 2 measurements are finished"):
        measure_batch([days], out, HERE, Stopping(), {"thorough": False}, report=False)
    assert measure(days, out).resumed == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows locks files by itself")
@pytest.mark.parametrize("force", [False, True])
def test_a_second_run_into_the_same_folder_is_refused(days: Path, tmp_path: Path, force: bool) -> None:
    out = tmp_path / "out"
    with BatchFolder(out), pytest.raises(InputError, match="another run is writing there"):
        measure_batch([days], out, HERE, SilentProgress(), {"thorough": False}, report=False, force=force)
    assert measure(days, out).resumed == 0


@pytest.mark.slow
def test_processes_give_the_same_numbers(days: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    shutil.copytree(days / "monday", days / "wednesday")
    shutil.copytree(days / "tuesday", days / "thursday")
    measure(days, tmp_path / "one")
    measure(days, tmp_path / "two", Workers(jobs=2))
    assert len(numbers(tmp_path / "one")) == 4
    assert numbers(tmp_path / "two") == numbers(tmp_path / "one")


class Cluster:
    """A scheduler and two workers as processes of their own, which can be killed."""

    def __init__(self, place: Path, repository: Path) -> None:
        self._place = place
        self._environment = os.environ | {"PYTHONPATH": str(repository), "DASK_DISTRIBUTED__WORKER__DAEMON": "False"}
        self._running: list[subprocess.Popen[bytes]] = []
        self.start(port=0)
        self.port = int(self.address.rsplit(":", maxsplit=1)[1])

    @property
    def address(self) -> str:
        return str(json.loads((self._place / "scheduler.json").read_text(encoding="utf-8"))["address"])

    def start(self, port: int) -> None:
        file = self._place / "scheduler.json"
        file.unlink(missing_ok=True)
        self._begin(
            "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--scheduler-file", str(file)
        )
        while not file.exists():
            time.sleep(0.1)
        self.start_worker()
        self.start_worker()

    def start_worker(self) -> None:
        options = ("--nthreads", "1", "--no-dashboard", "--no-nanny", "--local-directory", str(self._place))
        self._begin("worker", self.address, *options)

    def _begin(self, *command: str) -> None:
        with (self._place / f"{command[0]}.log").open("ab") as log:
            self._running.append(
                subprocess.Popen(
                    [sys.executable, "-m", "distributed.cli.dask_" + command[0], *command[1:]],
                    env=self._environment,
                    stdout=log,
                    stderr=log,
                )
            )

    def kill(self, number: int | None = None) -> None:
        """Kill one process, in the order in which they began, or all."""
        for one in self._running if number is None else [self._running[number]]:
            one.kill()
            one.wait()
        if number is None:
            self._running.clear()


@pytest.mark.slow
class TestCluster:
    @pytest.fixture(scope="class")
    def cluster(self, tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Iterator[Cluster]:
        pytest.importorskip("distributed")
        cluster = Cluster(tmp_path_factory.mktemp("cluster"), repository)
        yield cluster
        cluster.kill()
        # Of a scheduler that is killed Dask leaves a socket open, which its thread lets go seconds later; collected
        # then, it would fail some other test.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            for _ in range(6):
                time.sleep(0.5)
                gc.collect()

    def test_a_killed_worker_and_a_scheduler_started_anew_change_no_number(
        self, days: Path, tmp_path: Path, cluster: Cluster
    ) -> None:
        for number in range(6):
            shutil.copytree(days / ("monday", "tuesday")[number % 2], days / f"day_{number}")
        measure(days, tmp_path / "one")

        class Breaking(SilentProgress):
            """Kills a worker after the second measurement, and the whole cluster after the fourth."""

            def advanced(self, stage: Any) -> None:
                if stage.name == "measure folders" and stage.done == 2:
                    cluster.kill(1)
                    cluster.start_worker()
                if stage.name == "measure folders" and stage.done == 4:
                    cluster.kill()
                    cluster.start(cluster.port)

        there = Workers(scheduler=cluster.address)
        measure_batch([days], tmp_path / "there", there, Breaking(), {"thorough": False}, report=False)
        assert {row["status"] for row in index(tmp_path / "there").values()} == {"measured"}
        assert numbers(tmp_path / "there") == numbers(tmp_path / "one")


@pytest.mark.slow
def test_a_termination_signal_leaves_what_can_be_taken_up(days: Path, tmp_path: Path, repository: Path) -> None:
    """The command line, killed while it works, goes on with the same command."""
    for number in range(2):
        shutil.copytree(days / ("monday", "tuesday")[number % 2], days / f"day_{number}")
    command = [
        sys.executable,
        "-m",
        "heliogauge",
        "measure",
        str(days),
        "-o",
        str(tmp_path / "out"),
        "--no-report",
        "-q",
        "--jobs",
        "1",
    ]
    environment = os.environ | {"PYTHONPATH": str(repository)}
    running = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
    journal = tmp_path / "out" / JOURNAL_FILE
    while not (journal.exists() and journal.stat().st_size):
        assert running.poll() is None, running.stderr and running.stderr.read()
        time.sleep(0.05)
    running.send_signal(signal.SIGTERM)
    running.communicate()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(index(tmp_path / "out")) == 4
    assert not [file.name for file in (tmp_path / "out").iterdir() if file.name.startswith(".")]
