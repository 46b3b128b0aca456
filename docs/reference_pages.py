"""The reference that the code writes: keys, commands and doubts, as Markdown under docs/_build.

``python docs/reference_pages.py`` writes the three pages without building the documentation.
"""

import sys
from pathlib import Path

import typer

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

from command_pages import command_pages  # noqa: E402
from doubt_pages import doubt_pages  # noqa: E402

from heliogauge.instruments import every_kind  # noqa: E402
from heliogauge.measurement.key_tables import key_pages  # noqa: E402
from heliogauge.running.cli import app as command_line  # noqa: E402

BUILT = DOCS / "_build"


def write_reference_pages(folder: Path = BUILT) -> tuple[Path, ...]:
    """Write keys.md, commands.md and doubts.md into a folder and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {
        "keys.md": key_pages(every_kind().values()),
        "commands.md": command_pages(typer.main.get_command(command_line), "heliogauge"),
        "doubts.md": doubt_pages(DOCS.parent),
    }
    for name, text in pages.items():
        (folder / name).write_text(text, encoding="utf-8")
    return tuple(folder / name for name in pages)


if __name__ == "__main__":
    sys.stdout.writelines(f"{path}\n" for path in write_reference_pages())
