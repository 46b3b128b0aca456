"""Sizes and habits that no linter counts."""

import ast
from collections.abc import Iterator

import pytest

from tests.architecture.source_tree import Module, all_modules, is_numeric

MOST_MODULE_LINES = 500
MOST_FUNCTION_LINES = 80
USUAL_FUNCTION_LINES = 35
MOST_PARAMETERS = 6

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions_of(tree: ast.AST) -> Iterator[Function]:
    yield from (node for node in ast.walk(tree) if isinstance(node, Function))


def body_lines(function: Function) -> int:
    """Number of lines of a function's body, without its docstring."""
    body = function.body[1:] if ast.get_docstring(function) is not None and len(function.body) > 1 else function.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1


def n_parameters(function: Function) -> int:
    """Number of parameters a caller sees."""
    arguments = function.args
    names = [argument.arg for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    return len([name for name in names if name not in {"self", "cls"}])


def is_command(function: Function) -> bool:
    """Whether a function is a command: its parameters are the flags of the command line."""
    return any(
        isinstance(decorator, ast.Call)
        and isinstance(decorator.func, ast.Attribute)
        and decorator.func.attr in {"command", "callback"}
        for decorator in function.decorator_list
    )


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


@pytest.mark.parametrize("module", all_modules(), ids=str)
def test_habits(module: Module) -> None:
    found = [f"{module.path}:{line}: {why}" for line, why in habits(module.tree, numeric=is_numeric(module.name))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("module", all_modules(), ids=str)
def test_sizes(module: Module) -> None:
    lines = module.source.count("\n")
    found = [f"{module.path}: {lines} lines, {MOST_MODULE_LINES} at most"] if lines > MOST_MODULE_LINES else []
    for function in functions_of(module.tree):
        where = f"{module.path}:{function.lineno}: {function.name}"
        if body_lines(function) > MOST_FUNCTION_LINES:
            found.append(f"{where}: {body_lines(function)} lines, {MOST_FUNCTION_LINES} at most")
        if n_parameters(function) > MOST_PARAMETERS and not is_command(function):
            found.append(
                f"{where}: {n_parameters(function)} parameters, {MOST_PARAMETERS} at most; group what belongs together"
            )
    assert not found, "\n".join(found)


def test_most_functions_are_short() -> None:
    sizes = [body_lines(function) for module in all_modules() for function in functions_of(module.tree)]
    share = sum(size < USUAL_FUNCTION_LINES for size in sizes) / len(sizes)
    assert share >= 0.9, f"{share:.0%} of {len(sizes)} functions are under {USUAL_FUNCTION_LINES} lines, 90 % should be"


@pytest.mark.parametrize("module", all_modules(), ids=str)
def test_every_module_says_what_it_is_for(module: Module) -> None:
    assert ast.get_docstring(module.tree), f"{module.path}: the first line says what the module is for"


def test_the_counting_itself() -> None:
    """Negative controls."""
    tree = ast.parse(
        '''
@app.command("run")
def command(a, b, c, d, e, f, g): pass
def plain(self, a, *, b):
    """Text."""

    try:
        assert a
    except:
        print(b)
'''
    )
    command, plain = functions_of(tree)
    assert is_command(command)
    assert not is_command(plain)
    assert (n_parameters(command), n_parameters(plain)) == (7, 2)
    assert body_lines(plain) == 4
    assert len(list(habits(tree, numeric=True))) == 3
    assert len(list(habits(tree, numeric=False))) == 2
