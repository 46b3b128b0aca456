"""The command line's own tree: every command, with what it must be given."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import typer

from heliogauge.running import cli


@dataclass(frozen=True)
class Command:
    """One command, as the command line has it.

    words: Words that call it.
    arguments: Names of its arguments.
    options: The ways to write each of its options.
    required: Of those without which it refuses.
    """

    words: tuple[str, ...]
    arguments: tuple[str, ...]
    options: tuple[tuple[str, ...], ...]
    required: tuple[tuple[str, ...], ...]

    @property
    def reads(self) -> bool:
        """Whether it reads what somebody else may have damaged: not where its argument is a folder to write."""
        return bool(self.arguments) and self.words[-1] not in {"init", "synth"}

    def __str__(self) -> str:
        return " ".join(self.words)

    def call(self, more: tuple[str, ...]) -> tuple[str, ...]:
        """Return the words of a call that writes to "{out}", in one process and without a report, as far as it may.

        more: What stands behind its words; "{in}" for each argument where none is among them.
        """
        given = more if any("{" in word for word in more) else ("{in}",) * len(self.arguments) + more
        words = [*self.words, *given]
        for option, value in (("--out", ("{out}",)), ("--jobs", ("1",)), ("--no-report", ())):
            if any(option in ways and not set(ways) & set(words) for ways in self.options):
                words += [option, *value]
        missing = [ways[0] for ways in self.required if not set(ways) & set(words)]
        if missing:
            raise ValueError(f"{self}: {', '.join(missing)} must be given")
        return tuple(words)


@cache
def commands() -> dict[str, Command]:
    """Return all commands by the words that call them, in the order of the help."""
    found: dict[str, Command] = {}
    root: Any = typer.main.get_command(cli.app)
    waiting: list[tuple[tuple[str, ...], Any]] = [((), root)]
    while waiting:
        words, one = waiting.pop(0)
        if hasattr(one, "list_commands"):
            waiting += [((*words, name), one.get_command(None, name)) for name in one.list_commands(None)]
            continue
        options = [each for each in one.params if each.param_type_name == "option"]
        found[" ".join(words)] = Command(
            words,
            tuple(each.name for each in one.params if each.param_type_name == "argument"),
            tuple((*each.opts, *each.secondary_opts) for each in options),
            tuple(tuple(each.opts) for each in options if each.required),
        )
    return found
