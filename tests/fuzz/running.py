"""Draw cases, run each in a process of its own with limits, and say what went wrong."""

import contextlib
import faulthandler
import gc
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
from tests.fuzz.foreign import WRITTEN
from tests.fuzz.targets import SEEDS, TARGETS, Target, main, quiet

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
            needed |= {one for one in SEEDS if f"{{{one}}}" in words}
    for name, words in SEEDS.items():
        if name in needed and not folders[name].exists():
            if f"{{{name}}}" not in words:
                folders[name].mkdir(parents=True)
            _in_process(lambda words=words: main([word.format(**folders) for word in words]), 600)
            if not folders[name].is_dir() or not any(folders[name].iterdir()):
                raise RuntimeError(f"{name} could not be made: {' '.join(words)}")
    for name, write in WRITTEN.items():
        if name in needed and not folders[name].exists():
            folders[name].mkdir(parents=True)
            write(folders[name])
    return folders


def run_cases(place: Path, cases: Iterable[int], seed: int, targets: tuple[Target, ...] = TARGETS) -> Iterator[Outcome]:
    """Draw damaged folders and run what reads them; the number of a case and the seed decide on it."""
    seeds = make_seeds(place / "seeds", {name for one in targets for name in one.seeds()})
    # What every case needs is imported once: cases are copies of this process.
    with contextlib.suppress(SystemExit):
        quiet(lambda: main(["--help"]))
    _import_all()
    # Otherwise each case would copy most of this process to collect its garbage.
    gc.freeze()
    weights = [one.weight for one in targets]
    for number in cases:
        yield run_case(place, number, seed, seeds, random.Random(f"{seed}-{number}").choices(targets, weights)[0])


def run_case(place: Path, number: int, seed: int, seeds: dict[str, Path], target: Target) -> Outcome:
    """Run one case in a process of its own."""
    folder, out = place / "in", place / "out"
    _remove(place, "in", "out", "out-failed")
    copy_of(seeds[target.seed], folder)
    damage = spoil(folder, random.Random(f"{seed}-{number}-damage"))
    begin = time.monotonic()
    fault, peak = _in_process(lambda: target.run(folder, out, seeds), HANG_S)
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
