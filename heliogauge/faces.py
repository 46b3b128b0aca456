"""Public faces of packages: a few names, each imported from its module when it is first asked for."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple


class Face(NamedTuple):
    """What makes a package lazy (PEP 562): its ``__getattr__``, ``__dir__`` and ``__all__``."""

    load: Callable[[str], Any]
    names: Callable[[], list[str]]
    all_names: list[str]


def lazy_face(package: str) -> Face:
    """Make the face of a package from the imports that stand under ``if TYPE_CHECKING:`` in its ``__init__.py``.

    package: Its ``__name__``. ``from package import name`` names a room: a module is its own home.
    """
    if package != __package__:
        from heliogauge.instruments import refuse_hidden_packages

        refuse_hidden_packages()
    homes = face_homes(_source_of(package))

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(homes))}")
        home = homes[name]
        value = import_module(f"{package}.{name}") if home == package else getattr(import_module(home), name)
        setattr(sys.modules[package], name, value)
        return value

    return Face(load, lambda: sorted(homes), sorted(homes))


def face_homes(source: str) -> dict[str, str]:
    """Return the module of each name that a package file imports for type checkers."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            found = [one for one in node.body if isinstance(one, ast.ImportFrom) and one.module]
            return {alias.name: str(one.module) for one in found for alias in one.names}
    return {}


def _source_of(package: str) -> str:
    spec = sys.modules[package].__spec__
    # Loaders of zip files have the method, too, without being registered as `InspectLoader`.
    read = getattr(spec.loader, "get_source", None) if spec is not None else None
    source = read(package) if read is not None else None
    if source is None:
        raise ImportError(f"{package}: its source is needed to know its public names; install heliogauge with sources")
    return str(source)
