"""The instruments: what each of them can measure, found by entry points and imported only when it is needed.

The folder of an instrument holds an ``instrument.py`` with an `Instrument` value, which the entry point group
``heliogauge.instruments`` names. It imports nothing but this module: everything else is named by text,
``"package.module:name"`` for functions and types and ``"package:file"`` for files, and loaded when it is asked for.
"""

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from typing import Any

from heliogauge.errors import InputError

GROUP = "heliogauge.instruments"
#: Names that a message lists: more are no help on a terminal.
_MOST_NAMES = 40
#: Reports of results that no instrument measures: those of many folders at once.
_OWN_REPORTS = {"measurements": "heliogauge.batch:report.ipynb"}


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of measurement.toml.

    name: As measurement.toml says it: ``kind = "observer-plan"``.
    model: Type of what the file may say, a `heliogauge.measurement.models.MeasurementModel`.
    load: Function ``(folder) -> measurement`` that reads and checks a folder.
    template: File with a commented measurement.toml to start from.
    command: What follows ``heliogauge`` on the command line to evaluate a folder: ``"observer measure"``.
    init_option: Option of ``init`` that writes a file of this kind instead of the instrument's first.
    init_help: What that option is for.
    run: Function ``(measurement, options, progress) -> InstrumentResult``, without options where the kind has none.
    options: Dataclass of the choices that override those of measurement.toml.
    run_into: Function ``(measurement, out, options, progress, *, force, report)`` in place of run, where a measurement
        fills its folder of results itself.
    recognises: Function ``(folder) -> bool`` that knows folders of this kind without a measurement.toml.
    plan: Function ``(folder, progress) -> InstrumentResult`` that says what measuring a folder will be worth, before
        there are images.
    check: Function ``(measurement, findings)`` that adds what is wrong with a measurement before it is evaluated to the
        `heliogauge.measurement.findings.Findings`.
    """

    name: str
    model: str
    load: str
    template: str
    command: str
    init_option: str = ""
    init_help: str = ""
    run: str = ""
    options: str = ""
    run_into: str = ""
    recognises: str = ""
    plan: str = ""
    check: str = ""

    def init_command(self, folder: str) -> str:
        """Return what follows ``heliogauge`` to write a commented measurement.toml of this kind.

        folder: The folder, as it is to be named.
        """
        return f"{self.command.split()[0]} init {folder} {self.init_option}".rstrip()


@dataclass(frozen=True, slots=True)
class Instrument:
    """What an instrument offers.

    name: Its name, one word: that after ``heliogauge`` on the command line, and that of ``heliogauge.synth``.
    summary: What it measures, in one line; ``--help`` shows it without importing the commands.
    commands: The ``typer.Typer`` of its verbs; ``init`` and ``synth`` are added to them.
    kinds: Kinds of measurement.toml that it evaluates: the usual one first, the others with an `init_option`.
    reports: File of the report notebook of each kind of result.
    synth: Function ``(folder, *, preset, seed, force, progress)`` that writes a measurement folder with known truth.
    synth_command: The same as a command, with all that can be chosen.
    """

    name: str
    summary: str
    commands: str
    kinds: tuple[Kind, ...] = ()
    reports: Mapping[str, str] = field(default_factory=dict)
    synth: str | None = None
    synth_command: str | None = None


@cache
def instruments() -> tuple[Instrument, ...]:
    """Find the instruments that are installed, in the order of their names.

    InputError: A file of the user's has the name of an instrument's package.
    """
    refuse_hidden_packages()
    return tuple(point.load() for point in _entry_points())


def instrument_named(name: str) -> Instrument:
    """Return the instrument of a name.

    InputError: There is none; the message suggests the near one.
    """
    known = {one.name: one for one in instruments()}
    if name not in known:
        raise InputError(f"instrument {name!r} is not known; {near_match(name, known)}")
    return known[name]


def every_kind() -> dict[str, Kind]:
    """Return all kinds of measurement by their names."""
    return {kind.name: kind for one in instruments() for kind in one.kinds}


def every_report() -> dict[str, str]:
    """Return the file of the report notebook of each kind of result, as `read_resource` takes it."""
    return _OWN_REPORTS | {kind: file for one in instruments() for kind, file in one.reports.items()}


def near_match(name: str, known: Iterable[str], quote: str = "") -> str:
    """Say which known name is near a mistyped one, or which names there are.

    quote: Put around each name.
    """
    known = list(known)
    if near := get_close_matches(name, known, n=1):
        return f"did you mean {quote}{near[0]}{quote}?"
    if not known:
        return "available are: none, so heliogauge is not installed whole"
    more = f" and {len(known) - _MOST_NAMES} more" if len(known) > _MOST_NAMES else ""
    return "available are: " + ", ".join(f"{quote}{one}{quote}" for one in known[:_MOST_NAMES]) + more


def resolve(name: str) -> Any:
    """Import what a text names.

    name: ``"package.module:name"``.
    InputError: A file of the user's has the name of the package.
    """
    home, _, attribute = name.partition(":")
    _refuse_hidden(home)
    return getattr(import_module(home), attribute)


def read_resource(name: str) -> str:
    """Read a text file that belongs to a package.

    name: ``"package:file"``.
    """
    from importlib.resources import files

    refuse_hidden_packages()
    home, _, file = name.partition(":")
    return files(home).joinpath(file).read_text(encoding="utf-8")


@cache
def _entry_points() -> tuple[Any, ...]:
    from importlib.metadata import entry_points

    return tuple(sorted(entry_points(group=GROUP), key=lambda point: point.name))


@cache
def refuse_hidden_packages() -> None:
    """Check that no file of the user's would be imported in the place of an instrument's package.

    Instruments import each other, so the packages of all of them are looked at; nothing is imported here.
    InputError: There is such a file; the message names it.
    """
    for point in _entry_points():
        _refuse_hidden(point.module)


def _import_beside_data(package: str) -> bool:
    """Import a package that a folder of data of the same name would hide; return whether that was so.

    A folder without ``__init__.py`` is found as a namespace before the packages of an editable installation.
    """
    hidden = PathFinder.find_spec(package)
    if hidden is None or hidden.origin is not None:
        return False
    for finder in sys.meta_path:
        spec = None if finder is PathFinder else finder.find_spec(package, None)
        if spec is not None and spec.origin is not None and spec.loader is not None:
            sys.modules[package] = module = module_from_spec(spec)
            spec.loader.exec_module(module)
            return True
    return False


def _refuse_hidden(module: str) -> None:
    package, _, inside = module.partition(".")
    if not inside:
        return
    loaded = sys.modules.get(package)
    if loaded is not None:
        file, places = getattr(loaded, "__file__", None), list(getattr(loaded, "__path__", ()))
    elif _import_beside_data(package):
        return
    elif spec := PathFinder.find_spec(package):
        file, places = spec.origin, list(spec.submodule_search_locations or ())
    else:
        return
    if PathFinder.find_spec(f"{package}.{inside.partition('.')[0]}", places) is None:
        raise InputError(
            f"{file or ', '.join(places)} has the name of a package of heliogauge and would be imported in its place; "
            + ("rename it" if loaded is None else "rename it and start Python anew")
        )
