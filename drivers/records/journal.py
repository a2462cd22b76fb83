"""Journal of an agent: one JSON object a line, on disk before the agent acts on it."""

from __future__ import annotations

import errno
import json
import logging
import os
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.errors import JournalError
from drivers.messages import Filament, PrintSnapshot
from drivers.records.alarm import Alarm
from drivers.records.board_state import BoardState

log = logging.getLogger(__name__)

JOURNAL = "journal.jsonl"  # in an agent's folder
LATE = 1000  # prints that are kept in memory: more than a week's
ESTOPPED = "stopped by `farm estop`"  # the reason for attention that an emergency stop leaves behind


@dataclass(slots=True)
class Memory:
    """The journal read to its end.

    Attributes
    ----------
    print
        The last print and how it stood; open where its phase is no end.
    ended
        Prints that are over: none of them is ever started again.
    late
        The last of them, and what became of each.
    alarm
        A heater that could not be switched off, until a person has seen to the printer.
    board
        See `BoardState`.
    identity
        What tells this printer from others (`Session.identity`); None where nobody has seen it yet.
    """

    print: PrintSnapshot | None = None
    filament: Filament = Filament.UNKNOWN
    alarm: Alarm | None = None
    board: BoardState = field(default_factory=BoardState)
    identity: str | None = None
    ended: set[str] = field(default_factory=set)
    late: deque[PrintSnapshot] = field(default_factory=lambda: deque(maxlen=LATE))

    @property
    def heat(self) -> bool:
        """Whether the last agent may have left heat behind."""
        uncut = self.alarm is not None and (self.alarm.pending or self.alarm.open)
        return self.board.hot or uncut or (self.print is not None and not self.print.phase.ended)

    def take(self, record: dict[str, Any]) -> None:
        """Learn one record."""
        if "print" in record:
            said = record["print"]
            self.print = PrintSnapshot.model_validate(said) if said is not None else None
            if self.print is not None and self.print.phase.ended and self.print.print_id not in self.ended:
                self.ended.add(self.print.print_id)
                self.late.append(self.print)
        if "filament" in record:
            self.filament = Filament(record["filament"])
        if "alarm" in record:
            said = record["alarm"]
            self.alarm = Alarm.model_validate(said) if said is not None else None
        self.board = self.board.updated(record)
        if "identity" in record:
            self.identity = record["identity"]


def recall(path: Path) -> tuple[Memory, int]:
    """Read a journal, and how many bytes of it are whole records.

    What cannot be read may have been the beginning of a print: where no later record tells of its end, the
    printer may be hot, and a person has to look in any case.
    """
    memory, good, unknown = Memory(), 0, False
    if path.exists():
        for number, line in enumerate(path.read_bytes().split(b"\n")[:-1], 1):  # the rest was cut short
            good += len(line) + 1
            try:
                record = json.loads(line)
                memory.take(record)
                unknown = unknown and not {"print", "hot"} & record.keys()
            except (ValueError, TypeError, AttributeError):
                log.warning("%s:%d: cannot be read: %.80r", path, number, line)
                memory.board.attention_reason = f"its journal is damaged: see line {number} of {path}"
                unknown = True
    memory.board.hot = memory.board.hot or unknown
    return memory, good


class Journal:
    """An append-only file. `write` returns when the record is on the disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.memory, self._good = recall(path)
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        os.ftruncate(self._fd, self._good)
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)  # else a power cut may take a new file with all its records
        finally:
            os.close(folder)

    def write(self, at_s: float, **record: Any) -> None:
        """Put one record on the disk, and take it into `memory`.

        Raises
        ------
        JournalError
            The disk did not take it: neither the file nor `memory` has changed.
        """
        line = (json.dumps({"at_s": round(at_s, 3), **record}) + "\n").encode()
        try:
            os.lseek(self._fd, self._good, os.SEEK_SET)
            if os.write(self._fd, line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._fd)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._fd, self._good)
            raise JournalError(f"{self._path}: the disk does not take it ({error.strerror})") from error
        self._good += len(line)
        self.memory.take(record)
