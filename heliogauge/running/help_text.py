"""Help that is as wide as the terminal and never cut: long texts and long lists of choices go on in the next line."""

import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import typer
from typer.core import TyperGroup

#: Contexts and formatters are `Any`: typer below 0.26 takes them from click, later ones carry their own copy.
_Formatter: Any = typer.Context.formatter_class

#: The words before a text take at most this much, and at most this share of the line.
_FIRST_COLUMN, _FIRST_SHARE = 30, 0.4
#: A text in fewer columns than this goes below its words instead of beside them.
_TEXT_COLUMNS = 24


class WholeHelp(_Formatter):  # type: ignore[misc]
    """A formatter that breaks what is too long for the line."""

    def write_dl(self, rows: Sequence[tuple[str, str]], col_max: int = _FIRST_COLUMN, col_spacing: int = 2) -> None:
        """Write names with their meanings, both broken to the width of the terminal."""
        rows, room = list(rows), int(self.width - self.current_indent)
        widest = max(len(first) for first, _ in rows)
        column = min(widest, max(col_max, int(_FIRST_SHARE * room))) + col_spacing
        beside = room - column >= _TEXT_COLUMNS
        indent = " " * self.current_indent
        for first, second in rows:
            names = _broken(first, room)
            after = column if beside else 6
            meaning = textwrap.wrap(" ".join(second.split()), room - after)
            if beside and meaning and len(names) == 1 and len(names[0]) <= column - col_spacing:
                names = [names[0].ljust(column) + meaning.pop(0)]
            for line in [*names, *(" " * after + line for line in meaning)]:
                self.write(f"{indent}{line}\n")


class HelpContext(typer.Context):
    """A context that shows the whole help."""

    formatter_class = WholeHelp


#: Commands for all instruments, which none has of its own.
_FOR_ALL = ("check", "report", "view", "demo")


class VerbGroup(TyperGroup):
    """A group that lists what its commands do in whole sentences."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the arguments name; one for all instruments is named as it is called."""
        if args and args[0] in _FOR_ALL and self.get_command(ctx, args[0]) is None:
            ctx.fail(f"'{args[0]}' is for all instruments alike: heliogauge {' '.join(args)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        write_commands(formatter, "Commands", ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx)))


def write_commands(formatter: Any, title: str, commands: Iterable[tuple[str, Any]]) -> None:
    """Write a list of commands with the first paragraph of what they do."""
    with formatter.section(title):
        formatter.write_dl([(name, (one.help or "").strip().partition("\n\n")[0]) for name, one in commands])


def show_whole(command: Any) -> Any:
    """Let a command, and those in it, show the whole help.

    Returns: The command.
    """
    command.context_class = HelpContext
    for one in getattr(command, "commands", {}).values():
        show_whole(one)
    return command


def _broken(text: str, room: int) -> list[str]:
    """Break the words of an option before they run out of the line: between words, or after a choice's bar."""
    if len(text) <= room:
        return [text]
    lines = [""]
    for piece in text.replace("|", "|\0").replace(" ", " \0").split("\0"):
        if lines[-1] and len(lines[-1] + piece.rstrip()) > room:
            lines.append("    ")
        lines[-1] += piece
    return [line.rstrip() for line in lines]
