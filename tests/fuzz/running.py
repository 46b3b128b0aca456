"""Draw cases, run each in a process of its own with limits, and say what went wrong."""

import contextlib
import faulthandler
import gc
import hashlib
import io
import os
import random
import resource
import shutil
import signal
import time
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.architecture.source_tree import PACKAGES
from tests.fuzz.damage import copy_of, spoil
from tests.fuzz.foreign import WRITTEN, write_given
from tests.fuzz.headlines import SilentChangeError, silent_changes
from tests.fuzz.targets import ADDED, SEEDS, TARGETS, Target, main, quiet

#: A case that takes longer hangs: undamaged, the slowest takes 7 s on one core of its own.
HANG_S = 60.0
#: The clock of a busy machine runs faster than the work on it.
_BUSY = 4.0
MOST_MEMORY_BYTES = 2 * 10**9
_ADDRESSES_BYTES = 12 * 2**30


@dataclass(frozen=True)
class Outcome:
    """What came of a case.

    fault: Empty where it ended in results or one message; otherwise what went wrong, with the traceback.
    """

    number: int
    target: Target
    damage: str
    fault: str
    seconds: float
    peak_bytes: int

    def __str__(self) -> str:
        cost = f"{self.seconds:.1f} s, {self.peak_bytes / 1e6:.0f} MB"
        return f"case {self.number}: {self.target}\n  {self.damage}: {self.fault} ({cost})"


def make_seeds(place: Path, names: set[str]) -> dict[str, Path]:
    """Make undamaged folders, and those that they are made of."""
    folders = {name: place / name for name in (*SEEDS, *WRITTEN)}
    needed = set(names)
    for name, words in reversed(SEEDS.items()):
        if name in needed:
            needed |= {one for one in SEEDS if f"{{{one}}}" in (*words, *ADDED.get(name, "").split('"'))}
    for name, words in SEEDS.items():
        if name in needed and not folders[name].exists():
            if f"{{{name}}}" not in words:
                folders[name].mkdir(parents=True)
            _in_process(lambda words=words: main([word.format(**folders) for word in words]), 600)
            if not folders[name].is_dir() or not any(folders[name].iterdir()):
                raise RuntimeError(f"{name} could not be made: {' '.join(words)}")
            if name in ADDED:
                with (folders[name] / "measurement.toml").open("a", encoding="utf-8") as file:
                    file.write("\n" + ADDED[name].format(**folders))
            if name == "tests":
                write_given(folders[name])
    for name, write in WRITTEN.items():
        if name in needed and not folders[name].exists():
            folders[name].mkdir(parents=True)
            write(folders[name])
    return folders


def run_cases(place: Path, cases: Iterable[int], seed: int, targets: tuple[Target, ...] = TARGETS) -> Iterator[Outcome]:
    """Draw damaged folders and run what reads them; the number of a case and the seed decide on it."""
    seeds = _prepared(place, targets)
    weights = [one.weight for one in targets]
    for number in cases:
        target = random.Random(f"{seed}-{number}").choices(targets, weights)[0]
        if not (kept := _kept(place, target)).is_dir() and (refused := run_undamaged(place, seeds, target)).fault:
            yield refused
        yield run_case(place, number, seed, seeds, target, kept)


def check_undamaged(place: Path, targets: tuple[Target, ...]) -> None:
    """Run every target on its undamaged folder and print how long it takes, and what it refuses."""
    seeds = _prepared(place, targets)
    for target in targets:
        _remove(_kept(place, target).parent, _kept(place, target).name)
        outcome = run_undamaged(place, seeds, target)
        print(f"{outcome.seconds:6.1f} s {outcome.peak_bytes / 1e6:6.0f} MB: {target} {outcome.fault}", flush=True)


def _prepared(place: Path, targets: tuple[Target, ...]) -> dict[str, Path]:
    """Make the undamaged folders, and import what every case needs: cases are copies of this process."""
    seeds = make_seeds(place / "seeds", {name for one in targets for name in one.seeds()})
    with contextlib.suppress(SystemExit):
        quiet(lambda: main(["--help"]))
    _import_all()
    # Otherwise each case would copy most of this process to collect its garbage.
    gc.freeze()
    return seeds


def _kept(place: Path, target: Target) -> Path:
    """Return where the results of a target's undamaged folder are kept."""
    return place / "seeds" / "undamaged" / hashlib.sha256(str(target).encode()).hexdigest()[:16]


def run_undamaged(place: Path, seeds: dict[str, Path], target: Target) -> Outcome:
    """Run a target on its undamaged folder, which it must take: damage shows nothing in what is refused anyhow."""
    folder, out, kept = place / "in", place / "out", _kept(place, target)
    _remove(place, "in", "out", "out-failed")
    copy_of(seeds[target.seed], folder)

    def work() -> None:
        said = io.StringIO()
        try:
            with contextlib.redirect_stderr(said):
                target.run(folder, out, seeds)
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"the undamaged folder is refused: {said.getvalue()}") from None

    begin = time.monotonic()
    fault, peak = _in_process(work, HANG_S)
    kept.mkdir(parents=True)
    if (out / "summary.json").is_file():
        shutil.copy(out / "summary.json", kept)
    _remove(place, "in", "out", "out-failed")
    return Outcome(-1, target, "nothing", fault, time.monotonic() - begin, peak)


def run_case(
    place: Path, number: int, seed: int, seeds: dict[str, Path], target: Target, undamaged: Path | None = None
) -> Outcome:
    """Run one case in a process of its own.

    undamaged: Results of the undamaged folder, with which the numbers are compared.
    """
    folder, out = place / "in", place / "out"
    _remove(place, "in", "out", "out-failed")
    copy_of(seeds[target.seed], folder)
    damage = spoil(folder, random.Random(f"{seed}-{number}-damage"))

    def work() -> None:
        try:
            target.run(folder, out, seeds)
        except SystemExit as end:
            if not end.code and undamaged is not None and (changes := silent_changes(undamaged, out)):
                raise SilentChangeError("; ".join(changes)) from None
            raise

    begin = time.monotonic()
    fault, peak = _in_process(work, HANG_S)
    left = [one.name for one in place.iterdir() if one.name not in {"in", "out", "out-failed", "seeds"}]
    if left and not fault:
        fault = f"left behind: {', '.join(left)}"
    _remove(place, "in", "out", "out-failed", *left)
    if not fault and peak > MOST_MEMORY_BYTES:
        fault = "took more than 2 GB of memory"
    return Outcome(number, target, damage, fault, time.monotonic() - begin, peak)


def _in_process(work, limit_s: float) -> tuple[str, int]:
    """Return what went wrong in a copy of this process (empty: nothing), and its peak of memory."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        _child(work, writing, reading)
    os.close(writing)
    os.set_blocking(reading, False)
    said, end = b"", time.monotonic() + _BUSY * limit_s
    pause = 0.002
    while True:
        with contextlib.suppress(BlockingIOError):
            while part := os.read(reading, 65536):
                said += part
        pid, status, used = os.wait4(child, os.WNOHANG)
        if pid:
            break
        if time.monotonic() > end or _busy_s(child) > limit_s:
            # The child says where each of its threads stands.
            os.kill(child, signal.SIGUSR1)
            time.sleep(0.2)
            with contextlib.suppress(BlockingIOError):
                said += os.read(reading, 65536)
            os.killpg(child, signal.SIGKILL)
            _, status, used = os.wait4(child, 0)
            said = f"hangs: more than {limit_s:.0f} s\n".encode() + said
            break
        time.sleep(pause)
        pause = min(pause * 1.5, 0.05)
    with contextlib.suppress(BlockingIOError):
        while part := os.read(reading, 65536):
            said += part
    os.close(reading)
    if not said and os.WIFSIGNALED(status):
        said = f"killed by signal {os.WTERMSIG(status)}".encode()
    return said.decode("utf-8", "replace"), used.ru_maxrss * 1024


def _busy_s(process: int) -> float:
    """Return the time that a process has worked; 0 where the system does not tell."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _child(work, writing: int, reading: int) -> None:
    """Run the work and leave; everything unforeseen goes into the pipe."""
    said = ""
    try:
        os.close(reading)
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES_BYTES, _ADDRESSES_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        faulthandler.register(signal.SIGUSR1, file=writing)
        null = os.open(os.devnull, os.O_RDWR)
        for one in (0, 1, 2):
            os.dup2(null, one)
        try:
            _, err = quiet(work)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else (0 if end.code is None else 1)
            said = "" if code in (0, 2) else f"exit code {end.code}"
        except SilentChangeError as change:
            said = f"silently different: {change}"
        else:
            said = err if "Traceback" in err else ""
    except BaseException:
        said = traceback.format_exc(limit=-6)
    with contextlib.suppress(OSError):
        os.set_blocking(writing, True)
        os.write(writing, said.encode("utf-8", "replace")[-20_000:])
    os._exit(0)


def _remove(place: Path, *names: str) -> None:
    for name in names:
        path = place / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _import_all() -> None:
    import importlib
    import pkgutil

    import cv2

    cv2.setNumThreads(1)
    for package in PACKAGES:
        for one in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not one.name.endswith("__main__"):
                importlib.import_module(one.name)
    for name in ("matplotlib.pyplot", "pandas", "xarray", "h5netcdf", "scipy.optimize"):
        importlib.import_module(name)
