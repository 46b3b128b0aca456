"""Public faces: few names, loaded when asked for, described in full; what is inside is internal."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import numpy as np
import pytest
from numpydoc.validate import validate

from tests.architecture.source_tree import REPOSITORY, all_modules, faces, instruments

MOST_NAMES = 12
#: numpydoc's checks of a docstring that a user reads: sections complete, in order, with types.
CHECKS = frozenset(
    {
        "GL03",
        "GL05",
        "GL06",
        "GL07",
        "GL08",
        "SS02",
        "SS03",
        "SS04",
        "PR01",
        "PR02",
        "PR03",
        "PR04",
        "PR05",
        "PR07",
        "PR09",
        "PR10",
        "RT01",
        "RT03",
        "RT05",
        "SA02",
        "SA03",
        "SA04",
    }
)


@pytest.mark.parametrize("package", ["heliogauge", "data_synth", *instruments()])
def test_every_package_has_a_face(package: str) -> None:
    assert faces().get(package), f"{package}/__init__.py lists no name; see heliogauge.faces.lazy_face"


@pytest.mark.parametrize("package", faces())
def test_a_face_is_small_and_true(package: str) -> None:
    names = faces()[package]
    module = import_module(package)
    assert len(names) <= MOST_NAMES
    assert sorted(names) == module.__all__
    for name, home in names.items():
        # Which of the two it is would depend on what was imported before.
        inside = {other.name for other in all_modules()}
        assert home == package or f"{package}.{name}" not in inside, f"{package}.{name} is a module, too"
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018


def _public() -> list[str]:
    """Return the home of every function and class of the packages' own faces; rooms are for colleagues."""
    found = {
        f"{home}.{name}"
        for package in ("heliogauge", *instruments())
        for name, home in faces().get(package, {}).items()
        if home != package
    }
    return sorted(found)


@pytest.mark.parametrize("name", _public())
def test_what_is_public_is_described(name: str) -> None:
    home, _, last = name.rpartition(".")
    value = getattr(import_module(home), last)
    if not callable(value):
        return
    faults = [f"{code} {text}" for code, text in validate(name)["errors"] if code in CHECKS]
    assert not faults, f"{name}: {faults}"


def test_faces_are_lazy() -> None:
    """Looking at a package loads none of its modules and no library."""
    program = "import sys, " + ", ".join(["heliogauge", *instruments()]) + "; print('numpy' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert answer.stdout.strip() == "False"


def test_only_faces_stand_in_package_files() -> None:
    """An __init__.py says what the package is and lists its face; code stands in modules."""
    found = [
        f"{module.path}:{node.lineno}"
        for module in all_modules()
        if module.is_face and module.name != "heliogauge"
        for node in module.tree.body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
    ]
    assert not found, f"code in package files: {found}"


def _values_in(home: ModuleType) -> Iterator[type]:
    """Go through the dataclasses that a face lists, and those of the rooms and modules that it lists."""
    is_face = hasattr(home, "__all__")
    for name in home.__all__ if is_face else [name for name in vars(home) if not name.startswith("_")]:
        value = getattr(home, name)
        if isinstance(value, ModuleType) and is_face:
            yield from _values_in(value)
        elif isinstance(value, type) and is_dataclass(value) and (is_face or value.__module__ == home.__name__):
            yield value


@dataclass
class _Everything:
    """A value within a value."""

    texts: tuple[str, ...]


def _much(kind: Any) -> Any:
    """Return more than one wants to read of what a field may hold."""
    text = getattr(kind, "__name__", str(kind))
    if "Mapping" in text or "dict" in text:
        return {f"name {number}": np.full((300, 300), number) for number in range(500)}
    if "tuple" in text or "list" in text:
        return tuple(f"name {number} " * 50 for number in range(500))
    if "ndarray" in text:
        return np.linspace(-1.0, 1.0, 250_000).reshape(500, 500)
    one = next(part for part in (get_args(kind) or (kind,)) if part is not type(None))
    is_small = not isinstance(one, type) or issubclass(one, str | int | float | Path | Enum)
    return 1.23456789 if is_small else _Everything(("words",) * 10_000)


@pytest.mark.parametrize("package", ["heliogauge", *instruments(), "data_synth"])
def test_no_public_value_prints_more_than_one_reads(package: str) -> None:
    """A repr of 250,000 characters freezes a notebook."""
    found = list(dict.fromkeys(_values_in(import_module(package))))
    long = {}
    for kind in found:
        value = object.__new__(kind)
        for field in fields(kind):
            object.__setattr__(value, field.name, _much(field.type))
        if kind.__repr__ is not object.__repr__ and not hasattr(kind, "headline"):
            sizes = len(repr(value)), len(getattr(value, "_repr_html_", str)())
            if sizes[0] > 2000 or sizes[1] > 4000:
                long[f"{kind.__module__}.{kind.__qualname__}"] = sizes
    assert not long, f"derive from heliogauge.short_repr.ShortRepr: {long}"
