"""What is found wrong with a measurement folder before it is measured: all of it, not the first alone."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from heliogauge.doubts import Doubt, Severity, doubt_content
from heliogauge.errors import InputError, MetrologyError
from heliogauge.images.video_names import video_of
from heliogauge.running.progress import Progress

_ValueT = TypeVar("_ValueT")
_Arguments = ParamSpec("_Arguments")
#: So many files that have one and the same fault are named; the others are counted.
_MOST_NAMED = 5


@dataclass(frozen=True, slots=True)
class PhotoFacts:
    """What a photograph is: width and height [px], and bits of a pixel."""

    size_px: tuple[int, int]
    bits: int


@dataclass(slots=True)
class Findings:
    """What is wrong with a measurement folder, gathered step by step.

    faults: What makes measuring impossible, a sentence each.
    doubts: What makes a result doubtful, or is good to know.
    photos: Images that can be read.
    copies: Images with the content of another one, which they name.
    """

    faults: list[str] = field(default_factory=list)
    doubts: list[Doubt] = field(default_factory=list)
    photos: dict[Path, PhotoFacts] = field(default_factory=dict)
    copies: dict[Path, Path] = field(default_factory=dict)

    def attempt(
        self, job: Callable[_Arguments, _ValueT], *args: _Arguments.args, **options: _Arguments.kwargs
    ) -> _ValueT | None:
        """Do something that may refuse its input, and go on.

        Returns: What it returns; None where it refused.
        """
        try:
            return job(*args, **options)
        except MetrologyError as error:
            self.refuse(str(error))
            return None

    def content(self) -> dict[str, Any]:
        """Return what was found as JSON has it."""
        return {
            "faults": list(self.faults),
            "doubts": [doubt_content(one) for one in self.doubts],
            "images_count": len(self.photos),
            "copies": {path.name: first.name for path, first in self.copies.items()},
        }

    def refuse(self, *texts: str) -> None:
        """Note what makes measuring impossible; the same sentence counts once."""
        self.faults += [text for text in dict.fromkeys(texts) if text not in self.faults]

    def add(self, *doubts: Doubt | Iterable[Doubt] | None) -> None:
        """Note doubts, as checks return them."""
        for one in doubts:
            if one is not None:
                self.doubts += [one] if isinstance(one, Doubt) else list(one)

    def few_photos(self, files: Sequence[Path], needed: int, what: str) -> None:
        """Note that there are fewer photos than can give an answer.

        needed: The least number that can.
        what: What they are needed for.
        """
        if len(files) < needed:
            self.refuse(f"{len(files)} photos; {what} needs {needed} at least: take more")

    def refuse_copies(self) -> None:
        """Note images that are there twice."""
        if self.copies:
            named = _named([f"{copy.name} of {one.name}" for copy, one in self.copies.items()])
            self.refuse(f"images are copies of others: {named}; remove them (counted twice, sigmas are too small)")

    def sizes_px(self, files: Iterable[Path]) -> dict[str, tuple[int, int]]:
        """Return width and height of photos that can be read, by their names [px]."""
        return {file.name: self.photos[file].size_px for file in files if file in self.photos}

    def one_size(self, files: Sequence[Path]) -> tuple[int, int] | None:
        """Note photos that differ in size or depth from most.

        Returns: The usual size [px].
        """
        known = [file for file in files if file in self.photos]
        if not known:
            return None
        properties = ["{} x {} px, {} bit".format(*self.photos[file].size_px, self.photos[file].bits) for file in known]
        usual = Counter(properties).most_common(1)[0][0]
        odd = [f"{file.name} ({own})" for file, own in zip(known, properties, strict=True) if own != usual]
        if odd:
            self.refuse(
                f"images of one size and depth are needed; most have {usual}, but not {_named(odd)}; leave out what "
                "does not belong to the measurement"
            )
        return self.photos[known[properties.index(usual)]].size_px

    def summary(self) -> str:
        """Return in a few words what was looked at and what was found."""
        sizes = sorted({"{} x {} px, {} bit".format(*one.size_px, one.bits) for one in self.photos.values()})
        images = f"{len(self.photos)} images of {' and '.join(sizes)}; " if self.photos else ""
        weighty = sum(one.severity is not Severity.NOTE for one in self.doubts)
        found = [f"{n} {word}{'s' * (n > 1)}" for n, word in ((len(self.faults), "error"), (weighty, "warning")) if n]
        return images + (", ".join(found) or "nothing wrong was found")


def read_photos(
    folder: Path, files: Sequence[Path], findings: Findings, progress: Progress, *, jobs: int | None = None
) -> None:
    """Read every image to its end, and note those that cannot be read and those that are there twice.

    folder: The measurement's folder.
    jobs: Images side by side; None for as many as there are processors.
    """
    from heliogauge.images.photos import read_image
    from heliogauge.results.folder import find_copies, hash_files

    def look(file: Path) -> PhotoFacts | str:
        try:
            image = read_image(file)
        except InputError as error:
            return str(error)
        height, width = image.shape
        return PhotoFacts((width, height), 16 if image.dtype.itemsize == 2 else 8)

    files = list(dict.fromkeys(files))
    if not files:
        return
    # An image in memory for each: not more than can be read at the speed of a disk.
    with (
        progress.stage("read images", len(files)) as running,
        ThreadPoolExecutor(jobs or min(os.cpu_count() or 1, 4)) as pool,
    ):
        for file, found in zip(files, pool.map(look, files), strict=True):
            if isinstance(found, str):
                findings.refuse(found)
            else:
                findings.photos[file] = found
            running.advance()
    still = [file for file in files if file in findings.photos and video_of(file) == file]
    findings.copies = find_copies(still, hash_files(still, folder), folder)


def _named(texts: Sequence[str]) -> str:
    rest = len(texts) - _MOST_NAMED
    return ", ".join(texts[:_MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")
