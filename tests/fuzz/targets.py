"""What is tried on damaged files: every command of the command line and the Python face, with what is damaged.

The commands are those of the command line's own tree, the kinds of measurement those of the instruments: a test fails
when one of them has no folder here.
"""

import contextlib
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from heliogauge.instruments import every_kind
from heliogauge.running.cli import main
from tests.fuzz.command_tree import commands

#: How undamaged folders are made; each may use those before it. "{name}" is the folder of that name, small enough that
#: reading it costs little.
SEEDS: dict[str, tuple[str, ...]] = {
    "fringes": ("deflectometry", "synth", "{fringes}", "--gamma", "2.2", "--periods", "0.9,7.9", "--steps", "4"),
    "field": ("heliostat", "synth", "{field}", "--preset", "juelich", "--heliostats", "2", "--observations", "20"),
    "points": ("photogrammetry", "synth", "{points}", "--points-only", "--photos", "6"),
    "slopes": ("deflectometry", "measure", "{fringes}", "-o", "{slopes}", "--no-report", "--grid-step-mm", "25"),
    "coarse": ("deflectometry", "measure", "{fringes}", "-o", "{coarse}", "--no-report", "--grid-step-mm", "30"),
    "tracked": ("heliostat", "measure", "{field}", "-o", "{tracked}", "--quick", "--no-report"),
    "azel": ("heliostat", "synth", "{azel}", "--preset", "small", "--heliostats", "2"),
    "azel_tracked": ("heliostat", "measure", "{azel}", "-o", "{azel_tracked}", "--quick", "--no-report"),
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
    "dots": ("deflectometry", "synth", "{dots}", "--dots", "light"),
    "series": ("deflectometry", "synth", "{series}", "--dots", "marked", "--frames", "3"),
    "poses": ("deflectometry", "synth", "{poses}", "--poses", "2"),
    "scan": ("deflectometry", "synth", "{scan}", "--preset", "surface-scan"),
    "laser": ("deflectometry", "synth", "{laser}", "--preset", "laser-scan"),
    "gazing": ("deflectometry", "synth", "{gazing}", "--preset", "gazing"),
    "gazing_plan": ("deflectometry", "init", "{gazing_plan}", "--gazing-plan"),
    "stars": ("deflectometry", "synth", "{stars}", "--preset", "stars"),
    "overlay": ("deflectometry", "synth", "{overlay}", "--preset", "overlay"),
    "screen": ("deflectometry", "synth", "{screen}", "--preset", "screen-rims"),
    "beams": ("beam", "synth", "{beams}"),
    "flux": ("beam", "measure", "{beams}", "-o", "{flux}", "--no-report"),
    "tests": ("heliostat", "synth", "{tests}", "--preset", "tests"),
    "tested": ("heliostat", "test", "all", "{tests}", "-o", "{tested}", "--no-report"),
    "store": ("survey", "add", "{slopes}", "{tracked}", "--to", "{store}", "--date", "2026-03-04"),
}

#: What a synthetic measurement does not have, and commands read: added to its measurement.toml.
ADDED: dict[str, str] = {
    "scan": "[plan]\nwidth_m = 3.0\nheight_m = 2.0\ncolumns = 20\nrows = 14\n",
    "laser": "[plan]\nwidth_m = 1.5\nheight_m = 1.5\ncolumns = 12\nrows = 12\n",
    "tests": '[quality]\nresults = ["{slopes}"]\n\n[given]\nfile = "given.csv"\n',
}


@dataclass(frozen=True)
class Target:
    """Something that is run on a damaged folder.

    seed: Name of the folder that is damaged.
    words: Words of the command; "{in}" is the damaged folder, "{out}" where it writes, "{name}" an undamaged folder of
        `SEEDS`, "{stored}" a file of rows in the store. None: the Python face.
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
        # The name of a file of rows in the store, which differs from store to store.
        stored = next((undamaged.get("store", folder) / "rows").glob("*.parquet"), Path()).name
        places = {**undamaged, "in": folder, "out": out, "stored": stored}
        words = [word.format(**places) for word in self.words]
        if words[0] == "view":
            browse([Path(word) for word in words[1:]])
        else:
            main(words)

    def seeds(self) -> set[str]:
        """Return the undamaged folders that it needs."""
        return {self.seed} | {name for name in SEEDS if any(f"{{{name}}}" in word for word in self.words or ())}

    def __str__(self) -> str:
        return f"{' '.join(self.words)} (in: {self.seed})" if self.words else f"Python face of {self.seed}"


#: The folder that is damaged for each kind of measurement, how often it is drawn, and choices that make it quick.
KINDS: dict[str, tuple[str, float, tuple[str, ...]]] = {
    "beam": ("beams", 2.0, ()),
    "camera": ("board", 0.3, ("--no-leave-one-out",)),
    "deflectometry": ("fringes", 4.0, ("--grid-step-mm", "25")),
    "slopes": ("imported", 4.0, ()),
    "deflectometry-dots": ("dots", 0.5, ()),
    "deflectometry-dots-series": ("series", 0.2, ()),
    "deflectometry-poses": ("poses", 0.5, ("--grid-step-mm", "25")),
    "surface-scan": ("scan", 0.7, ()),
    "laser-scan": ("laser", 2.0, ()),
    "backward-gazing": ("gazing", 0.3, ()),
    "screen-geometry": ("screen", 0.15, ()),
    "stars": ("stars", 0.5, ()),
    "overlay": ("overlay", 0.3, ()),
    "backward-gazing-plan": ("gazing_plan", 0.2, ()),
    "heliostat": ("field", 4.0, ("--quick",)),
    "heliostat-tests": ("tests", 1.5, ()),
    "observer": ("trough", 0.2, ()),
    "observer-plan": ("flights", 0.2, ()),
    "photogrammetry": ("points", 1.0, ()),
    "photogrammetry-plan": ("stations", 0.7, ()),
    "response": ("grey", 3.0, ()),
}
#: Other folders of those kinds.
MORE_OF_KINDS: tuple[tuple[str, str, float, tuple[str, ...]], ...] = (("photogrammetry", "targets", 0.3, ()),)
#: Results, and how often their reports are drawn: those of a second each less often.
_MEASURED = {
    "slopes": 3.0, "tracked": 3.0, "absorber": 3.0, "network": 0.7, "camera": 0.7, "reflector": 0.4, "flux": 2.0,
    "tested": 2.0,
}  # fmt: skip
#: What stands in place of "{in}" where a command needs more, or another file than the folder.
_FROM_FILES = "{in}/measurement.h5 {in}/camera.h5 {in}/display.h5 {in}/orientation.h5 {in}/f.json"

#: All other commands that read: folder, how often it is drawn, and what stands behind the words of the command.
OTHERS: dict[str, tuple[tuple[str, float, str], ...]] = {
    "beam compare": (("beams", 0.4, ""),),
    "beam plan": (("beams", 0.3, ""),),
    "camera plan": (("camera", 0.2, "--photos 1"),),
    "camera import opencv": (("opencv", 3.0, "{in}/camera.yaml"),),
    "camera export opencv": (("camera", 2.0, ""),),
    "camera export colmap": (("camera", 2.0, ""),),
    "camera compare": (("camera", 2.0, "{in} {camera}"),),
    "deflectometry plan": (
        # Plans of dots, stars, overlay and screens trace for minutes.
        ("fringes", 0.2, ""), ("scan", 1.0, ""), ("laser", 1.0, ""), ("gazing_plan", 0.2, ""),
    ),
    "deflectometry import opencsp": (("opencsp", 5.0, _FROM_FILES),),
    "deflectometry import soltrace": (("soltrace", 3.0, "{in}/map.sht"),),
    "deflectometry import slopes": (("table", 3.0, "{in}/map.csv"), ("slopes", 2.0, "{in}/slope_map.nc")),
    "deflectometry import surface": (
        ("mesh", 3.0, "{in}/map.ply"), ("normals", 2.0, "{in}/points.csv"), ("nurbs", 4.0, "{in}/surface.h5"),
    ),
    "deflectometry export soltrace": (("slopes", 2.0, "{in} -o {in}/exported.sht"),),
    "deflectometry export ply": (("slopes", 2.0, ""),),
    "deflectometry export csv": (("slopes", 2.0, ""),),
    "deflectometry compare": (("slopes", 2.0, "{in} {coarse}"),),
    "heliostat plan": (("tracked", 0.5, ""),),
    "heliostat export controllers": (("azel_tracked", 2.0, ""),),
    "heliostat export artist": (("tracked", 2.0, ""),),
    "heliostat export table": (("tracked", 2.0, ""),),
    "heliostat aim": (
        ("tracked", 2.0, "{in} --step-minutes 60"), ("aimed", 2.0, "{tracked} --readings {in}/aim.csv"),
    ),
    "heliostat curves": (("azel_tracked", 1.0, ""),),
    "heliostat sheet": (
        ("tested", 3.0, "{in} --no-pdf"), ("tests", 2.0, "{tested} --no-pdf --limits {in}/limits.toml"),
    ),
    "observer export soltrace": (("reflector", 1.0, "{in} -o {in}/exported.sht"),),
    # Maps of one pass have no heights: refused.
    "observer export ply": (("slopes", 0.5, ""),),
    "observer export csv": (("reflector", 0.7, ""),),
    "observer align": (("reflector", 0.7, ""),),
    "observer overview": (("reflector", 0.7, "{in} {reflector}"),),
    "observer absorber": (("tube", 1.0, ""),),
    "observer compare": (("reflector", 0.7, "{in} {reflector}"),),
    "photogrammetry import colmap": (("colmap", 3.0, ""),),
    "photogrammetry export colmap": (("network", 2.0, ""),),
    "photogrammetry export soltrace": (("slopes", 0.5, "{in} -o {in}/exported.sht"),),
    "photogrammetry export ply": (("slopes", 0.5, ""),),
    "photogrammetry export csv": (("slopes", 0.5, ""),),
    "photogrammetry targets": (("targets", 0.3, "{in} -o {out}"),),
    "survey add": (
        ("tracked", 2.0, "{in} --to {out} --date 2026-03-04"), ("slopes", 1.0, "{in} --to {out} --date 2026-03-04"),
        ("store", 2.0, "{slopes} --to {in} --date 2026-03-05"),
    ),
    "survey check": (("store", 2.0, ""),),
    "survey remove": (("store", 1.0, "{in} {stored}"),),
    "survey event": (("store", 1.0, "{in} --subject * --date 2026-03-05 --what cleaned"),),
    "survey report": (("store", 3.0, ""),),
    "measure": (("imported", 3.0, "{in} {grey} -o {out}"),),
    "report": tuple((seed, weight, "") for seed, weight in _MEASURED.items()),
    "view": (*((seed, weight, "") for seed, weight in _MEASURED.items()), ("slopes", 2.0, "{in} {slopes}")),
    "check": tuple(
        (seed, 1.0, "") for seed in dict.fromkeys([*(one[0] for one in KINDS.values()), "targets"])
    ),
}  # fmt: skip


def _targets() -> Iterator[Target]:
    tree = commands()
    of_kinds = [(kind, *rest) for kind, rest in KINDS.items() if kind in every_kind()]
    for kind, seed, weight, more in (*of_kinds, *MORE_OF_KINDS):
        yield Target(seed, tree[every_kind()[kind].command].call(("{in}", *more)), weight)
        # One section of the tests alone: the commands beside that for all of them.
        if kind == "heliostat-tests":
            for name in tree:
                if name.startswith("heliostat test ") and name != every_kind()[kind].command:
                    yield Target(seed, tree[name].call(("{in}",)), 0.6)
    for name, folders in OTHERS.items():
        for seed, weight, more_words in folders:
            yield Target(seed, tree[name].call(tuple(more_words.split())), weight)
    for seed, weight in _MEASURED.items():
        yield Target(seed, None, 0.7 * weight)
    for seed, _, _ in KINDS.values():
        yield Target(seed, None, 1.0)


#: All of them.
TARGETS: tuple[Target, ...] = tuple(_targets())


def browse(places: Sequence[Path]) -> None:
    """Look at results as `heliogauge view` shows them: the first page, and all that it leads to."""
    from heliogauge.errors import MetrologyError
    from heliogauge.view.server.opened import NotServedError, open_place
    from heliogauge.view.server.site import Site

    with contextlib.suppress(MetrologyError):
        site = Site([open_place(place) for place in places])
        site.check()
        names = [f"1/{file.name}" for file in sorted(places[0].iterdir())]
        both = [("difference", {"first": "1/", "second": "2/"})] if len(places) == 2 else []
        for address, query in [("", {}), ("1/", {}), *((name, {}) for name in names), *both]:
            with contextlib.suppress(MetrologyError, NotServedError):
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

    if not (folder / "measurement.toml").exists():
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
