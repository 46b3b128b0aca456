"""Events of a store: what was done to whom, a small file for each."""

import hashlib
import os
from pathlib import Path

from calibration.survey.files.moments import read_day
from heliogauge.errors import InputError
from heliogauge.files.on_disk import put_on_disk
from heliogauge.results.folder import read_json
from heliogauge.results.json_file import json_text

EVENTS_FOLDER = "events"
_KEYS = ("subject", "date", "what")


def write_event(store: Path, subject: str, date: str, what: str) -> bool:
    """Note that something was done: a cleaning, a repair.

    subject: Whom; a text with * stands for all whose names match.
    Returns: Whether it was new; the same event is noted once.
    InputError: No day, no word, or the store cannot be written.
    """
    day = str(read_day(date, "event"))
    if not what.strip() or not subject.strip():
        raise InputError("event: subject and what was done are needed")
    content = {"subject": subject, "date": day, "what": what}
    text = json_text("event", content)
    folder = store / EVENTS_FOLDER
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.json"
    if path.is_file():
        return False
    partial = folder / f".{path.stem}.{os.getpid()}.partial"
    try:
        try:
            partial.write_text(text, encoding="utf-8")
            put_on_disk([partial])
            partial.replace(path)
            put_on_disk([folder])
        finally:
            partial.unlink(missing_ok=True)
    except (OSError, UnicodeEncodeError) as error:
        raise InputError(f"{folder}: cannot be written ({error}); check permissions and space") from error
    return True


def event_files(store: Path) -> list[Path]:
    """Return the files of events."""
    return sorted((store / EVENTS_FOLDER).glob("*.json"))


def read_event(file: Path) -> dict[str, str]:
    """Read an event: subject, date, what.

    InputError: It is none.
    """
    content = read_json(file)
    for key in _KEYS:
        if not isinstance(content.get(key), str):
            raise InputError(f"{file}: no event (its {key} is missing or no text); correct it, or remove the file")
    return {key: content[key] for key in _KEYS} | {"date": str(read_day(content["date"], f"{file}"))}


def read_events(store: Path) -> list[dict[str, str]]:
    """Return what was done, the earliest first.

    InputError: A file that is no event.
    """
    return sorted(map(read_event, event_files(store)), key=lambda one: (one["date"], one["subject"]))
