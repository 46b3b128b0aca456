"""Doubts are values: nothing is decided on the words of a text, and each finding has one code of its own."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

import pytest

from calibration.heliostat.diagnosis.findings import REMEDIES
from deflectometry.frames.light_checks import FaultKind
from heliogauge.results.folder import UNITS
from tests.architecture.source_tree import all_modules

#: What sentences for people are called.
_SENTENCES = frozenset({"doubt", "message", "note", "reason", "said", "sentence", "text", "warning"})
#: Attributes that hold sentences; a plain name ``text`` is often the content of a file.
_HELD = frozenset({"doubts", "message", "reason", "reasons", "text", "texts", "warnings"})
_SEARCHES = frozenset({"endswith", "find", "fullmatch", "index", "match", "rfind", "search", "startswith"})
#: Places where text is what a user wrote, not a sentence of ours.
_WRITTEN_BY_USERS = frozenset({"photogrammetry.keys.known_files"})
#: Where a doubt is made of a finding that has its code already.
_MADE_OF_FINDINGS = {
    "calibration.heliostat.diagnosis.findings": "self.kind",
    "deflectometry.frames.light_checks": "self.kind.value",
    "heliogauge.doubts": "str(content['code'])",
}


def decisions(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and source of comparisons and searches in sentences.

    tree: Of a module, or a part of it.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            for (left, right), operator in zip(pairwise(sides), node.ops, strict=True):
                if isinstance(operator, ast.In | ast.NotIn) and is_sentence(right) and not _is_name_of(left):
                    yield node.lineno, ast.unparse(node)
                if isinstance(operator, ast.Eq | ast.NotEq) and any(
                    is_sentence(one) and _is_words(other) for one, other in ((left, right), (right, left))
                ):
                    yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            searched = node.func.attr in _SEARCHES
            if searched and any(is_sentence(one) for one in (node.func.value, *node.args)):
                yield node.lineno, ast.unparse(node)


def is_sentence(node: ast.expr) -> bool:
    """Whether an expression is a sentence for people: by its name, or the message of an error."""
    if isinstance(node, ast.Name):
        return node.id in _SENTENCES - {"text"}
    if isinstance(node, ast.Attribute):
        return node.attr in _HELD
    if isinstance(node, ast.Subscript):
        return is_sentence(node.value) and not isinstance(node.value, ast.Name)
    if isinstance(node, ast.Call):
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        inner = node.args[0] if node.args else None
        of_error = isinstance(inner, ast.Name) and inner.id in {"error", "one", "failure"} and name == "str"
        fetched = isinstance(node.func, ast.Attribute) and node.func.attr == "get" and is_sentence(node.func.value)
        return of_error or fetched or (name == "str" and inner is not None and is_sentence(inner))
    return False


def _is_name_of(node: ast.expr) -> bool:
    """Whether the left side of ``in`` is a key: ``key in summary.texts``, ``doubt in doubts``."""
    return isinstance(node, ast.Attribute | ast.Name) and ast.unparse(node).split(".")[-1] in {"key", "name", "doubt"}


def _is_words(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value != ""


def doubts_made(tree: ast.AST) -> Iterator[ast.Call]:
    """Yield the calls that make doubts."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Doubt":
            yield node


def test_nothing_is_decided_on_words() -> None:
    found = [
        f"{module.path}:{line}: {source}"
        for module in all_modules()
        if module.name not in _WRITTEN_BY_USERS
        for line, source in decisions(module.tree)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "source",
    [
        'notes if text.text.startswith("sigma of ") else doubts',
        '[one for one in held.warnings if warning.startswith("split ")]',
        'summary.texts["unit"].startswith("metres")',
        'summary.texts.get("unit", "").startswith("metres")',
        '"not converged" in str(error)',
        '"times its sigma" in doubt.text',
        "[bad.name for bad in refused if bad.reason == 'shows no target']",
        're.match("no scale", one.text)',
    ],
)
def test_decisions_on_words_are_found(source: str) -> None:
    """Negative control: what stood in the code once, or could."""
    assert list(decisions(ast.parse(source)))


@pytest.mark.parametrize("source", ['"/" in name', "key in numbers", "one.code == 'scale_missing'", "reason or ''"])
def test_other_comparisons_are_none(source: str) -> None:
    assert not list(decisions(ast.parse(source)))


def test_each_finding_has_one_code_of_its_own() -> None:
    codes: Counter[str] = Counter()
    for module in all_modules():
        for call in doubts_made(module.tree):
            code = call.args[0]
            if isinstance(code, ast.Constant):
                codes[str(code.value)] += 1
            else:
                assert ast.unparse(code) == _MADE_OF_FINDINGS.get(module.name), f"{module.path}:{call.lineno}"
    codes.update(kind.value for kind in FaultKind)
    codes.update(list(REMEDIES))
    assert [code for code, count in codes.items() if count > 1] == []
    assert [code for code in codes if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", code)] == []
    assert len(codes) > 150


def test_numbers_of_doubts_name_their_unit() -> None:
    wrong = [
        f"{module.path}:{call.lineno}: {key.value}"
        for module in all_modules()
        for call in doubts_made(module.tree)
        for numbers in [*call.args[2:3], *(one.value for one in call.keywords if one.arg == "numbers")]
        if isinstance(numbers, ast.Dict)
        for key in numbers.keys
        if isinstance(key, ast.Constant) and not str(key.value).endswith(tuple(UNITS))
    ]
    assert not wrong, "\n".join(wrong)


def test_no_warnings_are_raised() -> None:
    """A doubt raised as a warning is in no result; said beside it are a missing report, swept folders, own faults."""
    wrong = [
        f"{module.path}:{node.lineno}"
        for module in all_modules()
        if module.name not in {f"heliogauge.results.{name}" for name in ("frame", "left_over", "folder")}
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Attribute) and ast.unparse(node) in {"warnings.warn", "warnings.catch_warnings"}
    ]
    assert not wrong, "\n".join(wrong)
