"""What is tried on damaged files: the commands and the Python face, each with the folder that is damaged.

The one list of commands: a new command is one more line.
"""

import contextlib
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from heliogauge.running.cli import main

#: How undamaged folders are made; each may use those before it. "{name}" is the folder of that name, small enough that
#: reading it costs little.
SEEDS: dict[str, tuple[str, ...]] = {
    "fringes": ("deflectometry", "synth", "{fringes}", "--gamma", "2.2", "--periods", "0.9,7.9", "--steps", "4"),
    "field": ("heliostat", "synth", "{field}", "--preset", "juelich", "--heliostats", "2", "--observations", "20"),
    "points": ("photogrammetry", "synth", "{points}", "--points-only", "--photos", "6"),
    "slopes": ("deflectometry", "measure", "{fringes}", "-o", "{slopes}", "--no-report", "--grid-step-mm", "25"),
    "tracked": ("heliostat", "measure", "{field}", "-o", "{tracked}", "--quick", "--no-report"),
    "aimed": ("heliostat", "aim", "{tracked}", "-o", "{aimed}", "--step-minutes", "60"),
    "network": ("photogrammetry", "measure", "{points}", "-o", "{network}", "--no-report"),
    "colmap": ("photogrammetry", "export", "colmap", "{network}", "-o", "{colmap}"),
    "targets": ("photogrammetry", "synth", "{targets}", "--scale", "0.6", "--photos", "4", "--jpeg-quality", "95"),
    "board": ("camera", "synth", "{board}", "--scale", "0.5", "--photos", "4"),
    "camera": ("camera", "measure", "{board}", "-o", "{camera}", "--no-leave-one-out", "--no-report"),
    "opencv": ("camera", "export", "opencv", "{camera}", "-o", "{opencv}/camera.yaml"),
    "trough": ("observer", "synth", "{trough}", "--photos", "12"),
    "reflector": ("observer", "measure", "{trough}", "-o", "{reflector}", "--no-report"),
    "tube": ("observer", "synth", "{tube}", "--preset", "absorber", "--scale", "0.5"),
    "absorber": ("observer", "absorber", "{tube}", "-o", "{absorber}", "--no-report"),
    "soltrace": ("deflectometry", "export", "soltrace", "{slopes}", "-o", "{soltrace}/map.sht"),
    "mesh": ("deflectometry", "export", "ply", "{slopes}", "-o", "{mesh}/map.ply"),
    "table": ("deflectometry", "export", "csv", "{slopes}", "-o", "{table}/map.csv"),
    "imported": ("deflectometry", "import", "slopes", "{slopes}/slope_map.nc", "-o", "{imported}"),
    "flights": ("observer", "init", "{flights}", "--plan"),
    "stations": ("photogrammetry", "init", "{stations}", "--plan"),
}


@dataclass(frozen=True)
class Target:
    """Something that is run on a damaged folder.

    seed: Name of the folder that is damaged.
    words: Words of the command; "{in}" is the damaged folder, "{out}" where it writes, "{name}" an undamaged folder of
        `SEEDS`. None: the Python face.
    weight: How often it is drawn, against the others: long ones less often.
    """

    seed: str
    words: tuple[str, ...] | None
    weight: float = 1.0

    def run(self, folder: Path, out: Path, undamaged: Mapping[str, Path]) -> None:
        """Run it; the command line ends with SystemExit."""
        if self.words is None:
            look_at(folder)
            return
        words = [word.format(**{**undamaged, "in": folder, "out": out}) for word in self.words]
        if words[0] == "view":
            browse([Path(word) for word in words[1:]])
        else:
            main(words)

    def seeds(self) -> set[str]:
        """Return the undamaged folders that it needs."""
        return {self.seed} | {name for name in SEEDS if any(f"{{{name}}}" in word for word in self.words or ())}

    def __str__(self) -> str:
        return " ".join(self.words) if self.words else f"Python face of {self.seed}"


def _measure(instrument: str, seed: str, weight: float, *more: str) -> Target:
    return Target(seed, (instrument, "measure", "{in}", "-o", "{out}", "--no-report", "--jobs", "1", *more), weight)


def _on(seed: str, weight: float, *commands: str) -> Iterator[Target]:
    for command in commands:
        yield Target(seed, tuple(command.split()), weight)


#: Results, and how often their reports are drawn: those of a second each less often.
_MEASURED = {"slopes": 3.0, "tracked": 3.0, "absorber": 3.0, "network": 0.7, "camera": 0.7, "reflector": 0.4}
_MEASURABLE = ("fringes", "field", "points", "board", "trough", "targets", "imported", "grey", "flights", "stations")

TARGETS: tuple[Target, ...] = (
    _measure("heliostat", "field", 4.0, "--quick"),
    _measure("photogrammetry", "points", 1.0),
    _measure("deflectometry", "fringes", 4.0, "--grid-step-mm", "25"),
    _measure("deflectometry", "imported", 5.0),
    _measure("screen", "grey", 3.0),
    _measure("photogrammetry", "targets", 0.3),
    _measure("camera", "board", 0.3, "--no-leave-one-out"),
    _measure("observer", "trough", 0.2),
    *(Target(seed, ("check", "{in}", "--jobs", "1"), 1.5) for seed in _MEASURABLE),
    *(Target(seed, ("report", "{in}"), weight) for seed, weight in _MEASURED.items()),
    *(Target(seed, ("view", "{in}"), weight) for seed, weight in _MEASURED.items()),
    *(Target(seed, None, 0.7 * weight) for seed, weight in _MEASURED.items()),
    *(Target(seed, None, 2.0) for seed in _MEASURABLE),
    Target("slopes", ("view", "{in}", "{slopes}"), 2.0),
    Target("imported", ("measure", "{in}", "{grey}", "-o", "{out}", "--jobs", "1", "--no-report"), 3.0),
    *_on("network", 2.0, "photogrammetry export colmap {in} -o {out}"),
    *_on("colmap", 4.0, "photogrammetry import colmap {in} -o {out}"),
    *_on("stations", 0.7, "photogrammetry plan {in} -o {out} --no-report"),
    *_on("flights", 0.2, "observer plan {in} -o {out} --no-report"),
    *_on("tracked", 2.0, "heliostat export controllers {in} -o {out}", "heliostat export artist {in} -o {out}"),
    *_on("tracked", 0.5, "heliostat plan {in} -o {out}"),
    *_on("tracked", 2.0, "heliostat aim {in} -o {out} --step-minutes 60", "heliostat export table {in} -o {out}"),
    *_on("aimed", 2.0, "heliostat aim {tracked} -o {out} --readings {in}/aim.csv"),
    *_on("targets", 0.3, "photogrammetry targets {in} -o {out} --no-report --jobs 1"),
    *_on("reflector", 0.7, "observer align {in} -o {out} --no-report",
         "observer overview {in} {reflector} -o {out} --no-report", "observer compare {in} {reflector} -o {out}"),
    *_on("tube", 1.0, "observer absorber {in} -o {out} --no-report --jobs 1"),
    *_on("slopes", 2.0, "deflectometry export soltrace {in} -o {in}/exported.sht",
         "deflectometry export ply {in} -o {out}", "deflectometry export csv {in} -o {out}",
         "deflectometry import slopes {in}/slope_map.nc -o {out}"),
    *_on("reflector", 1.0, "observer export soltrace {in} -o {in}/exported.sht"),
    *_on("soltrace", 3.0, "deflectometry import soltrace {in}/map.sht -o {out}"),
    *_on("mesh", 3.0, "deflectometry import surface {in}/map.ply -o {out}"),
    *_on("table", 3.0, "deflectometry import slopes {in}/map.csv -o {out}"),
    *_on("normals", 2.0, "deflectometry import surface {in}/points.csv -o {out}"),
    *_on("nurbs", 4.0, "deflectometry import surface {in}/surface.h5 -o {out}"),
    *_on("opencv", 4.0, "camera import opencv {in}/camera.yaml -o {out}"),
    *_on("camera", 2.0, "camera export opencv {in} -o {out}", "camera export colmap {in} -o {out}",
         "camera compare {in} {camera}"),
    *_on("camera", 0.2, "camera plan {in} -o {out} --no-report --photos 1"),
    *_on("opencsp", 5.0, "deflectometry import opencsp {in}/measurement.h5 {in}/camera.h5 {in}/display.h5 "
         "{in}/orientation.h5 {in}/f.json -o {out}"),
)  # fmt: skip


def browse(places: Sequence[Path]) -> None:
    """Look at results as `heliogauge view` shows them: the first page, and all that it leads to."""
    from heliogauge.errors import InputError
    from heliogauge.view.server.opened import NotServedError, open_place
    from heliogauge.view.server.site import Site

    with contextlib.suppress(InputError):
        site = Site([open_place(place) for place in places])
        site.check()
        names = [f"1/{file.name}" for file in sorted(places[0].iterdir())]
        both = [("difference", {"first": "1/", "second": "2/"})] if len(places) == 2 else []
        for address, query in [("", {}), ("1/", {}), *((name, {}) for name in names), *both]:
            with contextlib.suppress(InputError, NotServedError):
                site.answer(address, query)


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
