"""Work on several cores: parts of arrays that have nothing to do with each other.

No sum runs over the ends of parts, so results have the same bits whatever the number of threads.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

from albedo.errors import InputError

_Result = TypeVar("_Result")
_inside = threading.local()
# Parts for each thread: the machine may do other things as well.
_PARTS = 2


def threads() -> int:
    """How many threads pumping-up uses: ``ALBEDO_THREADS``, or one for every core.

    Raises
    ------
    InputError
        Where that is no number from 1 to 256.
    """
    chosen = os.environ.get("ALBEDO_THREADS", "")
    if not chosen:
        return _cores()
    if not chosen.isdecimal() or not 1 <= int(chosen) <= 256:
        raise InputError(f"ALBEDO_THREADS = {chosen!r} is out of range; it lies in [1, 256]")
    return int(chosen)


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(count: int, process: int) -> ThreadPoolExecutor:
    """Threads of this process: one that was forked has none of those before."""
    return ThreadPoolExecutor(count, initializer=_mark)


def _mark() -> None:
    """Let a thread know that it belongs to a pool: what waits in there must not wait for it."""
    _inside.pool = True


def side_by_side(work: Callable[[slice], _Result], count: int, least: int) -> list[_Result]:
    """What some work finds on every part of so many items, in their order.

    Parameters
    ----------
    work : callable
        ``work(part)`` for a slice; it lets go of the interpreter's lock, or there is no gain.
    count : int
        Of items.
    least : int
        Fewer items than this are not worth another part.
    """
    workers = 1 if hasattr(_inside, "pool") else threads()
    parts = min(_PARTS * workers, count // least) if workers > 1 else 1
    if parts < 2:
        return [work(slice(0, count))]
    ends = [count * k // parts for k in range(parts + 1)]
    slices = [slice(a, b) for a, b in itertools.pairwise(ends)]
    return list(_pool(workers, os.getpid()).map(work, slices))
