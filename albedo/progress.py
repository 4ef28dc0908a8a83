"""Long work tells whoever watches how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

Advance = Callable[[int, int], None]
Watcher = Callable[[str], AbstractContextManager[Advance]]

_watcher: ContextVar[Watcher | None] = ContextVar("watcher", default=None)


@contextmanager
def watched(watcher: Watcher) -> Iterator[None]:
    """Let long work inside the block tell how far it is.

    Parameters
    ----------
    watcher : callable
        ``watcher(what)`` is called when some work begins, and gives a context that lasts as long;
        what that yields is called as ``advance(done, known)``, from any thread: how much is done,
        and how much there is as far as is known, which may grow.
    """
    token = _watcher.set(watcher)
    try:
        yield
    finally:
        _watcher.reset(token)


@contextmanager
def long_work(what: str) -> Iterator[Advance]:
    """Begin some work that may take long; what is yielded tells how far it is."""
    watcher = _watcher.get()
    if watcher is None:
        yield lambda done, known: None
        return
    with watcher(what) as advance:
        yield advance
