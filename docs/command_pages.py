"""The reference of commands: a page made from the command line itself, so that both say the same."""

from typing import Any

import typer


def command_pages(group: Any, name: str) -> str:
    """Return the reference of a command line as Markdown: one section for each command.

    group: What ``typer.main.get_command`` returns.
    name: How the program is called.
    """
    return "\n".join(_sections(group, [name]))


def _sections(command: Any, path: list[str]) -> list[str]:
    """Return the sections of a command, or of a group and its commands."""
    context = typer.Context(command, info_name=" ".join(path))
    if not hasattr(command, "list_commands"):
        return _command(command, context, path)
    lines = [f"{'#' * len(path)} {' '.join(path[1:])}", "", (command.help or "").strip(), ""] if len(path) > 1 else []
    for one in command.list_commands(context):
        lines += _sections(command.get_command(context, one), [*path, one])
    return lines


def _command(command: Any, context: Any, path: list[str]) -> list[str]:
    """Return the section of a command: what it does, how it is called, what its arguments and options mean."""
    shown = [one for one in command.params if not getattr(one, "hidden", False)]
    arguments = [one for one in shown if one.param_type_name == "argument"]
    usage = " ".join([*path, *command.collect_usage_pieces(context)])
    lines = [
        f"{'#' * len(path)} {' '.join(path[1:])}",
        "",
        (command.help or "").strip(),
        "",
        "```text",
        usage,
        "```",
        "",
    ]
    if shown:
        lines += ["| argument or option | meaning |", "|---|---|"]
    for one in [*arguments, *(one for one in shown if one not in arguments)]:
        record = one.get_help_record(context)
        if record is not None:
            spelling, meaning = record
            lines.append(f"| {_code(spelling)} | {_text(meaning)} |")
    return [*lines, ""]


def _code(text: str) -> str:
    return "`" + " ".join(text.split()).replace("|", "\\|") + "`"


def _text(text: str) -> str:
    """Return a help text as it stands in a cell of a table."""
    escaped = " ".join(text.split())
    for sign in "\\|<>*_[]":
        escaped = escaped.replace(sign, "\\" + sign)
    return escaped
