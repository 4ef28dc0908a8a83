"""Work on several cores: parts of arrays that have nothing to do with each other."""

from __future__ import annotations

import itertools
import math
import operator
import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ContextDecorator, contextmanager
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np

from albedo.errors import InputError

_Result = TypeVar("_Result")
_MOST = 256
_SHARES = 3


def threads() -> int:
    """How many threads pumping-up uses: ``ALBEDO_THREADS``, or one for every core.

    Raises
    ------
    InputError
        Where that is no number from 1 to 256.
    """
    chosen = os.environ.get("ALBEDO_THREADS", "")
    if not chosen:
        return _cores(os.getpid())
    if not chosen.isdecimal() or not 1 <= int(chosen) <= _MOST:
        raise InputError(f"ALBEDO_THREADS = {chosen!r} is out of range; it lies in [1, {_MOST}]")
    return int(chosen)


@cache
def _cores(process: int) -> int:
    """Cores that this process has when it first asks: not all of a machine are there for each."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, _MOST)


class _BlasInOne(ContextDecorator):
    """While it is entered products of matrices take one thread, whoever computes them.

    BLAS's own threads wait for the next product without sleep, in the way of ours: pumping-up
    takes a quarter longer beside them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._limit: Any = None
        self._own = threading.local()
        # The libraries, and how many modules there were when they were looked for.
        self._controller: Any = None
        self._modules = 0

    def __enter__(self) -> None:
        self._own.depth = getattr(self._own, "depth", 0) + 1
        if self._own.depth > 1:
            return
        with self._lock:
            # Some keep a number for each thread.
            limit = self._libraries().limit(limits=1, user_api="blas")
            if self._users == 0:
                # Whoever comes second may find the limit of the first.
                self._limit = limit
            self._users += 1

    def __exit__(self, *_: object) -> None:
        self._own.depth -= 1
        if self._own.depth > 0:
            return
        with self._lock:
            self._users -= 1
            self._limit.restore_original_limits()

    def _libraries(self) -> Any:
        from threadpoolctl import ThreadpoolController

        # Modules bring libraries with them; to look for those takes half a millisecond.
        if self._controller is None or self._modules != len(sys.modules):
            self._controller, self._modules = ThreadpoolController(), len(sys.modules)
        return self._controller


blas_in_one = _BlasInOne()


def side_by_side(work: Callable[[slice], _Result], count: int, least: int) -> list[_Result]:
    """What some work finds on parts of so many items, in their order.

    Parameters
    ----------
    work : callable
        ``work(part)`` for a slice; what it finds of an item is the same in any part. It lets go of
        the interpreter's lock, or there is no gain.
    count : int
        Of items.
    least : int
        Fewer items than this are not worth a second part.
    """
    parts = _worth(count, least)
    return _found(work, [count * k // parts for k in range(parts + 1)], parts)


def by_weight(work: Callable[[slice], _Result], weight: np.ndarray, least: float) -> list[_Result]:
    """What some work finds on parts of items that weigh about the same, in their order.

    Parameters
    ----------
    work : callable
        As for `side_by_side`.
    weight : ndarray, shape (n,)
        What each item costs.
    least : float
        Less than this is not worth a second part.
    """
    sums = np.cumsum(weight)
    total = float(sums[-1]) if sums.size else 0.0
    workers = _worth(total, least)
    # Some more parts than threads: not all that weighs the same takes as long.
    parts = max(min(_SHARES * workers, int(total // least)), 1)
    if parts == 1:
        return [work(slice(0, sums.size))]
    inner = np.searchsorted(sums, total * np.arange(1, parts) / parts)
    return _found(work, [0, *np.unique(inner[inner > 0]).tolist(), sums.size], workers)


def in_batches(work: Callable[[slice], _Result], count: int, size: int) -> list[_Result]:
    """What some work finds on batches of a size, in their order.

    They are the same whatever the number of threads, and so are roundings that depend on them.
    """
    parts = max(-(-count // size), 1)
    return _found(work, [count * k // parts for k in range(parts + 1)], threads())


def _worth(amount: float, least: float) -> int:
    """How many threads some work is worth, of which twice the least is worth two.

    Every thread has to be woken up, and the lock of the interpreter is handed to one at a time: p
    of them take W / p + p w, which is least where p is the root of W / w.
    """
    most = math.isqrt(int(2.0 * amount / least))
    return min(threads(), most) if most > 1 else 1


class _AtWork:
    """How many threads work, of which those that wait for others are none: those make room."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0
        self._own = threading.local()

    def __enter__(self) -> None:
        self._own.depth = getattr(self._own, "depth", 0) + 1
        if self._own.depth == 1:
            self.change(1)

    def __exit__(self, *_: object) -> None:
        self._own.depth -= 1
        if self._own.depth == 0:
            self.change(-1)

    @contextmanager
    def reserved(self) -> Iterator[None]:
        """In a thread that was counted when it was asked for."""
        self._own.depth = 1
        try:
            yield
        finally:
            self._own.depth = 0
            self.change(-1)

    def change(self, count: int) -> None:
        with self._lock:
            self._count += count

    def reserve(self, most: int) -> int:
        """Count so many more, or as many as there is room for; return how many."""
        if most <= 0:
            return 0
        with self._lock:
            count = min(most, max(threads() - self._count, 0))
            self._count += count
        return count


_at_work = _AtWork()


def _found(work: Callable[[slice], _Result], ends: list[int], most: int) -> list[_Result]:
    parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
    if len(parts) == 1:
        return [work(parts[0])]
    todo, found = iter(range(len(parts))), cast(list[_Result], [None] * len(parts))
    others: list[Future[None]] = []

    def help_() -> None:
        with _at_work.reserved(), _or_none(todo):
            for k in todo:
                found[k] = work(parts[k])

    with _at_work:
        try:
            with _or_none(todo):
                # Whoever waits works as well; there may be room for more by and by.
                for k in todo:
                    left = min(operator.length_hint(todo), most - 1 - len(others))
                    for _ in range(_at_work.reserve(left)):
                        others.append(_pool(threads(), os.getpid()).submit(help_))
                    found[k] = work(parts[k])
        finally:
            _wait(others)
    return found


@contextmanager
def _or_none(todo: Iterator[int]) -> Iterator[None]:
    """Nothing more is begun once something failed."""
    try:
        yield
    finally:
        for _ in todo:
            pass


def _wait(others: list[Future[None]]) -> None:
    """Wait for those that have begun something, and leave room for others meanwhile."""
    _at_work.change(-1)
    try:
        for other in others:
            if other.cancel():
                _at_work.change(-1)
            else:
                other.result()
    finally:
        _at_work.change(1)


@cache
def _pool(count: int, process: int) -> ThreadPoolExecutor:
    """Threads of this process: one that was forked has none of those before.

    They are one more than work at once, because whoever waits makes room for another.
    """
    return ThreadPoolExecutor(count)
