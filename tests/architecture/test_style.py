"""Habits that no linter counts."""

import ast
from collections.abc import Iterator

from tests.architecture.source_tree import all_modules, is_numeric


def habits(tree: ast.Module, *, numeric: bool) -> Iterator[tuple[int, str]]:
    """Yield line and reason of each thing library code does not do."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield node.lineno, "assert disappears with -O; raise InputError or EstimationError with the remedy"
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            yield node.lineno, "bare except hides bugs and Ctrl-C; name the exception"
        if (
            numeric
            and isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in {"print", "open"}
        ):
            yield node.lineno, f"numeric module: no {node.func.id}(); files and terminals are the border's"


def test_habits() -> None:
    found = [
        f"{module.path}:{line}: {why}"
        for module in all_modules()
        for line, why in habits(module.tree, numeric=is_numeric(module.name))
    ]
    assert not found, "\n".join(found)


def test_every_module_says_what_it_is_for() -> None:
    silent = [module.path for module in all_modules() if not ast.get_docstring(module.tree)]
    assert not silent, f"the first line says what the module is for: {', '.join(silent)}"


def test_the_habits_themselves() -> None:
    """Negative controls."""
    tree = ast.parse(
        """
def plain(a):
    try:
        assert a
    except:
        print(a)
"""
    )
    assert len(list(habits(tree, numeric=True))) == 3
    assert len(list(habits(tree, numeric=False))) == 2
