"""Run a page's listings in their order and write what the program says into them.

``python docs/page_listings.py PAGE... --data DATA`` writes the listings of pages anew; a test compares them with what
the program says. What runs: the commands of ``console`` and ``sh`` blocks, and ``python`` blocks, each followed by the
``text`` block that shows its output. A block after ``<!-- file: PATH -->`` is written to that file; one after
``<!-- not run -->`` is left alone.
"""

import argparse
import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent

#: Public measurements that a page takes as read, relative to the folder of data: from where, to where.
PUBLIC: dict[str, tuple[tuple[str, str], ...]] = {
    "README.md": (
        ("opencsp/fringe/measurement_facet.h5", "opencsp"),
        ("opencsp/common/camera_sofast_downsampled.h5", "opencsp"),
        ("opencsp/common/display_distorted_3d.h5", "opencsp"),
        ("opencsp/common/spatial_orientation.h5", "opencsp"),
        ("opencsp/common/Facet_NSTTF.json", "opencsp"),
    ),
    "docs/tutorials/camera.md": (("opencsp/camera_calibration/*.png", "board"),),
    "docs/tutorials/deflectometry.md": (
        ("opencsp/fringe/measurement_facet.h5", "opencsp"),
        ("opencsp/common/camera_sofast_downsampled.h5", "opencsp"),
        ("opencsp/common/display_distorted_3d.h5", "opencsp"),
        ("opencsp/common/spatial_orientation.h5", "opencsp"),
        ("opencsp/common/Facet_NSTTF.json", "opencsp"),
        ("opencsp/fringe/image_calibration.h5", "opencsp"),
    ),
    "docs/tutorials/heliostat.md": (("csp/juelich_calibration/*", "juelich"),),
    "docs/tutorials/photogrammetry.md": (("opencsp/scene_reconstruction/aruco_marker_images/*.JPG", "room/photos"),),
    "docs/tutorials/beam.md": (),
    "docs/tutorials/observer.md": (),
    "docs/python/index.md": (),
}

#: Columns to which lines are folded: those of the pages' own text.
WIDTH = {"README.md": 120, "docs/python/index.md": 120}

_FENCE = re.compile(r"^(?P<indent> *)```(?P<kind>\w+)\n(?P<body>.*?)^(?P=indent)```$", re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"<!-- (?P<mark>file: (?P<path>\S+)|not run) -->\s*\Z")
#: How long a stage took, and what only a terminal with a person before it shows.
_DURATION = re.compile(r": \d+\.\d+ s$")


@dataclass(frozen=True, slots=True)
class Listing:
    """A block of a page: kind, text without indent, where it stands, and what the comment before it says."""

    kind: str
    body: str
    start: int
    end: int
    indent: str
    file: str | None
    runs: bool


def listings(text: str) -> list[Listing]:
    """Return the blocks of a page in their order."""
    found = []
    for match in _FENCE.finditer(text):
        mark = _MARK.search(text, 0, match.start())
        indent = match["indent"]
        found.append(
            Listing(
                match["kind"],
                textwrap.dedent(match["body"]) if indent else match["body"],
                match.start("body"),
                match.end("body"),
                indent,
                mark["path"] if mark else None,
                not mark or mark["path"] is not None,
            )
        )
    return found


def prepare(page: str, data: Path, folder: Path) -> None:
    """Put the public measurements of a page where its text says that they are.

    FileNotFoundError: They are not on this machine.
    """
    for source, target in PUBLIC[page]:
        files = sorted(data.glob(source))
        if not files:
            raise FileNotFoundError(f"{data / source}: the page's measurements are not there")
        (folder / target).mkdir(parents=True, exist_ok=True)
        for file in files:
            copy: Any = shutil.copytree if file.is_dir() else shutil.copy
            copy(file, folder / target / file.name)


def printed(page: str, text: str, folder: Path) -> Iterator[tuple[Listing, str]]:
    """Run the blocks of a page in a folder; yield each block that shows an output, with what it shows now."""
    width = WIDTH.get(page, 80)
    names: dict[str, Any] = {"__name__": "page"}
    pending: str | None = None
    blocks = [one for one in listings(text) if one.runs]
    for one in blocks:
        if one.file is not None:
            (folder / one.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / one.file).write_text(one.body, encoding="utf-8")
    for one in blocks:
        if one.kind in ("console", "sh"):
            shown = "".join(_command(command, folder, width) for command in commands(one))
            if one.kind == "console":
                yield one, shown
        elif one.kind == "python":
            pending = _python(one.body, names, folder)
        elif one.kind == "text" and pending is not None:
            yield one, pending
            pending = None


def commands(listing: Listing) -> list[str]:
    """Return the commands of a console or sh block; one that goes over several lines is one, with its line ends."""
    lines = listing.body.splitlines()
    if listing.kind == "console":
        joined = re.findall(r"^\$ ((?:.*\\\n)*.*)$", listing.body, re.MULTILINE)
        return [str(command) for command in joined]
    return [line for line in lines if line and not line.startswith("heliogauge view")]


def _command(command: str, folder: Path, width: int) -> str:
    """Return a command and what it says, folded as on the page."""
    surroundings = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, (str(DOCS.parent), os.environ.get("PYTHONPATH")))),
        "COLUMNS": "1000",
    }
    words = re.sub(r"^heliogauge\b", f"{sys.executable} -m heliogauge", command)
    done = subprocess.run(
        words, check=False, shell=True, cwd=folder, env=surroundings, capture_output=True, text=True, timeout=900
    )
    said = [line for line in (done.stderr + done.stdout).splitlines() if line and not _DURATION.search(line)]
    return "".join(f"{line}\n" for line in [f"$ {command}", *(folded(line, width) for line in said)])


def folded(line: str, width: int) -> str:
    """Return a line of output as the pages show it: words moved to further lines, which are indented."""
    own = line[: len(line) - len(line.lstrip())]
    indent = "    " if len(own) < 4 else f"{own}    "
    return "\n".join(
        textwrap.wrap(
            line,
            width,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
            drop_whitespace=True,
            replace_whitespace=False,
        )
    )


def _python(code: str, names: dict[str, Any], folder: Path) -> str:
    """Run a block of Python where the page's earlier blocks ran; return what it prints."""
    out = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        exec(compile(code, "page", "exec"), names)
    return out.getvalue()


def unfolded(text: str) -> list[str]:
    """Return the lines of a listing, those that were folded in one, with single blanks."""
    return [" ".join(line.split()) for line in re.sub(r"\n {4,}", " ", text).splitlines() if line.strip()]


def write(page: str, data: Path) -> None:
    """Write what the page's commands print now into the page."""
    file = DOCS.parent / page
    text = file.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        prepare(page, data, Path(name))
        for listing, shown in reversed(list(printed(page, text, Path(name)))):
            if unfolded(shown) != unfolded(listing.body):
                text = text[: listing.start] + textwrap.indent(shown, listing.indent) + text[listing.end :]
    file.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="*", default=list(PUBLIC), metavar="PAGE")
    parser.add_argument("--data", type=Path, required=True, help="folder of the public measurements")
    chosen = parser.parse_args()
    for page in chosen.pages:
        write(page, chosen.data.resolve())
