"""Hidden folders beside results while a run writes them, and what is done with those of runs that were killed."""

import os
import platform
import re
import secrets
import shutil
import warnings
from pathlib import Path

from heliogauge.errors import SweptWarning

#: A folder that is being written, and earlier results while the new ones take their place.
PARTIAL, EARLIER = "partial", "earlier"
_OWNER = re.compile(r"(?P<host>[0-9A-Za-z-]*)\.(?P<process>[0-9]+)\.[0-9a-f]{8}\.(?P<ending>partial|earlier)")


def hidden_beside(target: Path, ending: str) -> Path:
    """Return a new name beside a folder that tells which process it belongs to.

    ending: `PARTIAL` or `EARLIER`.
    """
    return target.parent / f".{target.name}.{_host()}.{os.getpid()}.{secrets.token_hex(4)}.{ending}"


def sweep(target: Path) -> None:
    """Remove what killed runs of the same result left beside it; earlier results that they had moved away come back.

    Only folders that such a run on this machine made, whose process is gone. What was done is said as a `SweptWarning`.
    """
    for path in sorted(target.parent.glob(f".{_literal(target.name)}.*")):
        found = _OWNER.fullmatch(path.name.removeprefix(f".{target.name}."))
        is_own = found is not None and found["host"] == _host() and path.is_dir() and not path.is_symlink()
        if found is None or not is_own or _is_running(int(found["process"])):
            continue
        if found["ending"] == EARLIER and not target.exists():
            path.rename(target)
            text = f"earlier results that a killed run had moved to {path.name} are back in {target}"
        else:
            shutil.rmtree(path, ignore_errors=True)
            text = f"{path}: a killed run had left it; it was removed"
        warnings.warn(text, SweptWarning, stacklevel=3)


def _literal(name: str) -> str:
    return re.sub(r"([*?\[])", r"[\1]", name)


def _host() -> str:
    return re.sub(r"[^0-9A-Za-z-]", "-", platform.node())[:40]


def _is_running(process: int) -> bool:
    if os.name == "nt":
        # There a signal would end it; what a killed run left is then swept by hand.
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        # It belongs to somebody else.
        return True
    return True
