"""How much memory is free, and the refusal of data that would need more."""

import sys
from pathlib import Path

from heliogauge.errors import InputError

MIB = 1 << 20
#: What is left to the other programs, and to what is computed from the data.
_SPARE_SHARE = 0.2
_GROUP_LIMITS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (
        Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
        Path("/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ),
)


def free_bytes() -> int:
    """Return how much memory this process can still take; a very large number where the system does not tell."""
    return max(min(_of_machine(), _of_group(), _of_process()), 0)


def refuse_large(where: str, needed_bytes: int, what: str) -> None:
    """Refuse data that the free memory cannot hold.

    where: The file, for messages.
    needed_bytes: What reading takes at its peak.
    what: What the data are: "30000 x 30000 px".
    InputError: The memory does not suffice.
    """
    # Looking costs more than reading a small file.
    if needed_bytes < 16 * MIB:
        return
    free = free_bytes()
    if needed_bytes > (1 - _SPARE_SHARE) * free:
        raise InputError(
            f"{where}: {what} need {needed_bytes / 2**30:.1f} GiB of memory, {free / 2**30:.1f} GiB are free; make the "
            "data smaller, close other programs, or take a machine with more memory"
        )


def _of_machine() -> int:
    try:
        text = Path("/proc/meminfo").read_text(encoding="ascii")
    except OSError:
        return sys.maxsize
    found = [line.split() for line in text.splitlines() if line.startswith("MemAvailable:")]
    return int(found[0][1]) * 1024 if found else sys.maxsize


def _of_group() -> int:
    for limit, used in _GROUP_LIMITS:
        try:
            return int(limit.read_text(encoding="ascii")) - int(used.read_text(encoding="ascii"))
        except (OSError, ValueError):
            # No such file here, or "max".
            continue
    return sys.maxsize


def _of_process() -> int:
    try:
        import resource
    except ImportError:
        return sys.maxsize
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return sys.maxsize
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (OSError, ValueError):
        return limit
    return limit - pages * resource.getpagesize()
