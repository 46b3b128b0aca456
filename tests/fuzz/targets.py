"""What is tried on damaged files: the commands and the Python face, each with the folder that is damaged.

The one list of commands: a new command is one more line.
"""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from heliogauge.running.cli import main

#: How undamaged folders are made; each may use those before it. "{name}" is the folder of that name.
SEEDS: dict[str, tuple[str, ...]] = {
    "fringes": ("deflectometry", "synth", "{fringes}", "--gamma", "2.2"),
    "field": ("heliostat", "synth", "{field}", "--observations", "12"),
    "points": ("photogrammetry", "synth", "{points}", "--points-only", "--photos", "10"),
    "slopes": ("deflectometry", "measure", "{fringes}", "-o", "{slopes}", "--no-report"),
    "tracked": ("heliostat", "measure", "{field}", "-o", "{tracked}", "--quick", "--no-report"),
    "network": ("photogrammetry", "measure", "{points}", "-o", "{network}", "--no-report"),
    "colmap": ("photogrammetry", "export", "colmap", "{network}", "-o", "{colmap}"),
    "targets": ("photogrammetry", "synth", "{targets}", "--scale", "0.6", "--photos", "6", "--jpeg-quality", "95"),
    "board": ("camera", "synth", "{board}", "--scale", "0.5", "--photos", "5"),
    "camera": ("camera", "measure", "{board}", "-o", "{camera}", "--no-leave-one-out", "--no-report"),
    "trough": ("observer", "synth", "{trough}"),
    "reflector": ("observer", "measure", "{trough}", "-o", "{reflector}", "--no-report"),
}


@dataclass(frozen=True)
class Target:
    """Something that is run on a damaged folder.

    seed: Name of the folder that is damaged.
    words: Words of the command; "{in}" is the damaged folder, "{out}" where it writes. None: the Python face.
    weight: How often it is drawn, against the others: long ones less often.
    """

    seed: str
    words: tuple[str, ...] | None
    weight: float = 1.0

    def run(self, folder: Path, out: Path) -> None:
        """Run it; the command line ends with SystemExit."""
        if self.words is None:
            look_at(folder)
        else:
            main([word.format(**{"in": folder, "out": out}) for word in self.words])

    def __str__(self) -> str:
        return " ".join(self.words) if self.words else f"Python face of {self.seed}"


def _measure(instrument: str, seed: str, weight: float, *more: str) -> Target:
    return Target(seed, (instrument, "measure", "{in}", "-o", "{out}", "--no-report", "--jobs", "1", *more), weight)


TARGETS: tuple[Target, ...] = (
    _measure("heliostat", "field", 6.0, "--quick"),
    _measure("photogrammetry", "points", 6.0),
    _measure("deflectometry", "fringes", 4.0),
    _measure("photogrammetry", "targets", 1.0),
    _measure("camera", "board", 1.0, "--no-leave-one-out"),
    _measure("observer", "trough", 0.7),
    *(Target(seed, ("report", "{in}"), 3.0) for seed in ("slopes", "tracked", "network", "camera", "reflector")),
    *(Target(seed, None, 3.0) for seed in ("slopes", "tracked", "network", "camera", "reflector")),
    *(Target(seed, None, 2.0) for seed in ("fringes", "field", "points", "board", "trough", "targets")),
    Target("slopes", ("measure", "{in}", "-o", "{out}"), 0.5),
    Target("network", ("photogrammetry", "export", "colmap", "{in}", "-o", "{out}"), 3.0),
    Target("colmap", ("photogrammetry", "import", "colmap", "{in}", "-o", "{out}"), 4.0),
    Target("tracked", ("heliostat", "export", "controllers", "{in}", "-o", "{out}"), 3.0),
    Target("tracked", ("heliostat", "export", "artist", "{in}", "-o", "{out}"), 2.0),
    Target("tracked", ("heliostat", "plan", "{in}", "-o", "{out}", "--no-report"), 0.5),
    Target("reflector", ("observer", "align", "{in}", "-o", "{out}", "--no-report"), 2.0),
    Target("reflector", ("observer", "overview", "{in}", "{in}", "-o", "{out}", "--no-report"), 1.0),
    Target("opencsp", ("deflectometry", "import", "opencsp", "{in}/measurement.h5", "{in}/camera.h5", "{in}/display.h5",
                       "{in}/orientation.h5", "{in}/f.json", "-o", "{out}"), 6.0),
)  # fmt: skip


def look_at(folder: Path) -> None:
    """Look at a folder as a notebook does: open or load it, and ask for everything."""
    import heliogauge as hg
    from heliogauge.errors import InputError

    ends = []

    def attempt(work: Callable[[], object]) -> None:
        try:
            work()
        except InputError as error:
            ends.append(str(error))

    if not (folder / "truth.json").exists():
        with contextlib.suppress(InputError):
            result = hg.open(folder)
            for name in ("slope_map", "angles", "height"):
                attempt(lambda name=name: getattr(result, name))
            for name in result.tables:
                attempt(lambda name=name: result.tables[name])
            attempt(lambda: (repr(result), result._repr_html_()))
            attempt(result.plot)
    else:
        attempt(lambda: hg.load(folder))


def quiet(work: Callable[[], object]) -> tuple[str, str]:
    """Return what was written on standard output and error while something ran."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        work()
    return out.getvalue(), err.getvalue()
