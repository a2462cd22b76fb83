"""Streams of the farm's events, which are limited in number and end with the daemon."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Protocol

from farm.http.stream_limit import StreamLimit
from farm.state.event_rows import EventRow

_MAX_STREAMS_PER_CALLER = 4
_MAX_BATCH_EVENTS = 20  # maximum number of events read at once, because each may take megabytes
_POLLS_PER_HEARTBEAT = 30  # number of polls without an event between two heartbeats


class EventLog(Protocol):
    """Log of all events, numbered from 1."""

    def find_last_event_number(self) -> int:
        """Return the number of the last event. Raises StoreError."""

    def read_events(self, last_number: int, limit: int) -> Sequence[EventRow]:
        """Read the events after a number, oldest first. Raises StoreError."""

    def read_printer_events(self, printer: str, limit: int) -> Sequence[EventRow]:
        """Read the events of a printer that its page shows, newest first. Raises StoreError."""


class EmptyEventLog:
    """Log without events."""

    def find_last_event_number(self) -> int:
        """Return 0."""
        return 0

    def read_events(self, last_number: int, limit: int) -> Sequence[EventRow]:
        """Return no events."""
        return ()

    def read_printer_events(self, printer: str, limit: int) -> Sequence[EventRow]:
        """Return no events."""
        return ()


class EventStreams(StreamLimit):
    """Open streams of events, whose number is limited.

    Parameters
    ----------
    log
        The event log.
    limit
        Maximum number of streams at a time; one caller may have four.
    poll_interval_s
        Seconds between two reads of the log.
    """

    def __init__(self, log: EventLog, limit: int = 16, poll_interval_s: float = 0.5) -> None:
        super().__init__(limit, _MAX_STREAMS_PER_CALLER)
        self.log, self._poll_interval_s = log, poll_interval_s

    async def follow(
        self, last_number: int, is_allowed: Callable[[], bool], wait: bool
    ) -> AsyncIterator[list[EventRow]]:
        """Yield new events as they are committed, and an empty list at intervals while there are none.

        Parameters
        ----------
        last_number
            Number of the last event that the caller has.
        is_allowed
            Function that returns whether the caller may still see events.
        wait
            Whether to wait for further events at the end of the log.
        """
        idle_polls = 0
        while is_allowed() and not self.is_closed:
            rows = list(self.log.read_events(last_number, _MAX_BATCH_EVENTS))
            if rows:
                last_number, idle_polls = rows[-1].number, 0
                yield rows
                await asyncio.sleep(0.0)  # lets other tasks run even if the client reads without delay
                continue
            if not wait:
                return
            idle_polls += 1
            if idle_polls % _POLLS_PER_HEARTBEAT == 0:
                yield []
            await self.wait(self._poll_interval_s)
