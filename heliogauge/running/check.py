"""Everything that can be found wrong with a measurement folder before it is measured; nothing is written."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from heliogauge.files.texts import read_toml
from heliogauge.instruments import Kind, resolve
from heliogauge.measurement.files import image_files
from heliogauge.measurement.findings import Findings, read_photos
from heliogauge.measurement.load import MEASUREMENT_FILE, kind_of, refuse_missing
from heliogauge.running.progress import Progress

#: Keys of [images] that name an image, and those that name several.
_SINGLE = ("dark", "bright")
_SEVERAL = ("fringes", "photos", "grey")


def check_folder(folder: Path, progress: Progress, *, jobs: int | None = None) -> tuple[Kind | None, Findings]:
    """Check a measurement folder of any kind.

    jobs: Images that are read side by side; None for as many as there are processors.
    Returns: What kind of measurement it is, and what was found.

    What one fault hides is checked as far as it can be: a mistyped key does not keep the images from being read.
    """
    findings = Findings()
    kind = findings.attempt(kind_of, folder)
    if kind is None:
        return None, findings
    measurement = findings.attempt(resolve(kind.load), folder)
    read_photos(folder, list(_images(folder, measurement, findings)), findings, progress, jobs=jobs)
    if measurement is not None and kind.check:
        with progress.stage("check the set-up"):
            resolve(kind.check)(measurement, findings)
    return kind, findings


def _images(folder: Path, measurement: Any, findings: Findings) -> Iterator[Path]:
    """Yield the images that a folder names, also where the rest of its measurement.toml cannot be meant."""
    if measurement is not None:
        for name in ("photo_files", "fringe_files", "grey_files", "absorber_files"):
            yield from getattr(measurement, name, ())
        section = getattr(measurement.model, "images", None)
        yield from (folder / text for key in _SINGLE if (text := getattr(section, key, None)) is not None)
        return
    file = folder / MEASUREMENT_FILE
    content = (findings.attempt(read_toml, file) or {}) if file.is_file() else {}
    # Missing photos, which are looked for first, do not keep quiet about missing tables.
    told = "\n".join(findings.faults)
    named_files = [(name, folder / name) for name in _files(content)]
    untold = [path for name, path in named_files if not (_names(told, name) or _names(told, str(path)))]
    findings.attempt(refuse_missing, file, untold)
    section = content.get("images")
    named = section if isinstance(section, dict) else {}
    for key in _SEVERAL:
        value = named.get(key)
        if isinstance(value, str) or (isinstance(value, list) and all(isinstance(one, str) for one in value)):
            yield from findings.attempt(image_files, folder, f"images.{key}", value) or ()
    for key in _SINGLE:
        if isinstance(value := named.get(key), str) and (folder / value).is_file():
            yield folder / value


def _names(text: str, name: str) -> bool:
    """Return whether a text has a file's whole name in it, not as a part of another one."""
    return re.search(rf"(?<!\S){re.escape(name)}(?![^\s,:;])", text) is not None


def _files(content: Any) -> Iterator[str]:
    """Yield the names of files that keys called ``file``, or ending so, have anywhere in a measurement.toml."""
    values = content.items() if isinstance(content, dict) else enumerate(content if isinstance(content, list) else ())
    for key, value in values:
        if isinstance(value, str) and str(key).split("_")[-1] == "file":
            yield value
        else:
            yield from _files(value)
