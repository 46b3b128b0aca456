"""The same work for many numbers in several threads."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

ResultT = TypeVar("ResultT")


def side_by_side(work: Callable[[int], ResultT], numbers: Sequence[int], jobs: int | None) -> list[ResultT]:
    """Do the same for many numbers in several threads; the first error ends it.

    jobs: Threads at most; as many as there are cores without.
    Exception: What the work raised first; what had not begun is left.

    >>> side_by_side(lambda number: 2 * number, [3, 1], jobs=2)
    [6, 2]
    """
    with ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(work, number) for number in numbers]
        try:
            return [future.result() for future in waiting]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
