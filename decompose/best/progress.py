"""Progress of a search, reported to the listener of the current context (thread or task)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_LISTENER: ContextVar[Callable[[float], None] | None] = ContextVar("listener", default=None)


@contextmanager
def listen_to_progress(listener: Callable[[float], None]) -> Iterator[None]:
    """Call a function with the progress of each search that runs within the context.

    Parameters
    ----------
    listener
        Function that is called with the spent share of the budget of the engine `best`, 0 to 1. A search may
        end before the share is 1; engines without a budget report nothing.
    """
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def report_progress(share: float) -> None:
    """Report the spent share of the budget, 0 to 1, to the listener of this context, if there is one."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(share)
