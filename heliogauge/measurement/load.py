"""Read measurement.toml and check it before any work is done.

The reader of an instrument (``keys``) is the border: whatever it returns is complete, in range, and names files that
exist. Everything else ends as one `InputError` that names file, key, value and remedy.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import ValidationError

from heliogauge.errors import InputError
from heliogauge.files.own_folder import refuse_leading_out
from heliogauge.files.regular import refuse_silent
from heliogauge.files.texts import read_toml
from heliogauge.instruments import Kind, every_kind, near_match, resolve
from heliogauge.measurement.faults import fault_lines
from heliogauge.measurement.models import MeasurementModel

MEASUREMENT_FILE = "measurement.toml"
#: What a folder of results has.
_SUMMARY_FILE = "summary.json"
_ModelT = TypeVar("_ModelT", bound=MeasurementModel)


def load(folder: str | Path) -> Any:
    """Read and check a measurement folder of any kind, without measuring.

    Parameters
    ----------
    folder : str or Path
        Folder with measurement.toml; the files it names are relative to it.

    Returns
    -------
    object
        The measurement: what the file says as `model`, and where its files are; its type depends on the kind.

    Raises
    ------
    InputError
        No such folder or file, not TOML, an unknown kind, an unknown or missing key, a value of the wrong type or out
        of range, or a file that does not exist.
    """
    folder = Path(folder).expanduser()
    return resolve(kind_of(folder).load)(folder)


def kind_of(folder: Path) -> Kind:
    """Return the kind of a measurement folder.

    InputError: No such folder or file, not TOML, or a kind that no instrument measures.
    """
    if not os.path.lexists(folder / MEASUREMENT_FILE):
        for kind in every_kind().values():
            if kind.recognises and resolve(kind.recognises)(folder):
                return kind
    return _kind(_read_toml(folder), folder / MEASUREMENT_FILE)


def read_measurement(folder: Path, model_type: type[_ModelT]) -> tuple[Path, _ModelT]:
    """Read the measurement.toml of a folder, which must be of one kind.

    folder: Folder with measurement.toml.
    model_type: What a file of this kind may say.
    Returns: The file, and what it says; the files it names are not looked for.
    InputError: No such folder or file, not TOML, another kind, an unknown or missing key, or a value of the wrong type
        or out of range.
    """
    file = folder / MEASUREMENT_FILE
    (wanted,) = get_args(model_type.model_fields["kind"].annotation)
    content = _read_toml(folder, wanted)
    kind = _kind(content, file)
    if kind.name != wanted:
        raise InputError(
            f'{file}: kind = "{kind.name}" is not "{wanted}"; evaluate this folder with `heliogauge {kind.command}`'
        )
    return file, _validated(content, model_type, file, kind)


def parse_measurement(content: dict[str, Any], file: Path) -> MeasurementModel:
    """Check the content of a measurement.toml of any kind, without looking for the files it names.

    content: The tables of the file.
    file: Where they come from, for messages.
    InputError: An unknown kind, an unknown or missing key, or a value of the wrong type or out of range.
    """
    kind = _kind(content, file)
    model_type: type[MeasurementModel] = resolve(kind.model)
    return _validated(content, model_type, file, kind)


def refuse_missing(file: Path, paths: Sequence[Path]) -> None:
    """Check that files exist that a measurement.toml names.

    file: The measurement.toml.
    InputError: Some do not exist; all of them are named.
    """
    own = file.parent
    missing = [
        str(path.relative_to(own) if path.is_relative_to(own) else path)
        for path in dict.fromkeys(paths)
        if not os.path.isfile(path)
    ]
    if missing:
        raise InputError(f"{file}: there is no file {', '.join(missing)} in {own}")
    refuse_leading_out(own, paths)


def _validated(content: dict[str, Any], model_type: type[_ModelT], file: Path, kind: Kind) -> _ModelT:
    try:
        return model_type.model_validate(content)
    except ValidationError as error:
        lines = fault_lines(error, model_type, f"heliogauge {kind.init_command('FOLDER')}")
        separator = " " if len(lines) == 1 else "\n  "
        raise InputError(f"{file}:{separator}" + "\n  ".join(lines)) from None


def _read_toml(folder: Path, kind: str = "") -> dict[str, Any]:
    file = folder / MEASUREMENT_FILE
    refuse_silent(folder)
    if not os.path.isdir(folder):
        raise InputError(f"{folder}: there is no such folder; give a folder with {MEASUREMENT_FILE} and its images")
    if not os.path.lexists(file) and os.path.isfile(folder / _SUMMARY_FILE):
        raise InputError(f"{folder}: results, not a measurement; give the folder that was measured")
    if not os.path.lexists(file):
        command = every_kind()[kind].init_command(str(folder)) if kind else f"INSTRUMENT init {folder}"
        raise InputError(f"{file}: there is no such file; write one with `heliogauge {command}` and fill it in")
    refuse_leading_out(folder, [file])
    return read_toml(file)


def _kind(content: dict[str, Any], file: Path) -> Kind:
    kinds = every_kind()
    name = content.get("kind")
    if name is None:
        known = ", ".join(f'"{kind}"' for kind in kinds)
        raise InputError(f"{file}: kind is missing; say one of {known} at the top of the file")
    if not isinstance(name, str) or name not in kinds:
        hint = near_match(str(name), kinds, quote='"')
        raise InputError(f"{file}: kind = {name!r} is not known; {hint}")
    return kinds[name]
