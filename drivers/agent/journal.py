"""What an agent must know after it died: one JSON object a line, on disk before the agent acts on it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.messages import Filament, PrintSnapshot


@dataclass(slots=True)
class Memory:
    """The journal read to its end.

    Attributes
    ----------
    print
        The last print and how it stood; open where its phase is no end.
    ended
        Prints that are over: none of them is ever started again.
    look
        Why a person has to look at the printer, until they did.
    """

    print: PrintSnapshot | None = None
    filament: Filament = Filament.UNKNOWN
    look: str | None = None
    ended: set[str] = field(default_factory=set)

    def take(self, record: dict[str, Any]) -> None:
        """Learn one record."""
        if "print" in record:
            said = record["print"]
            self.print = PrintSnapshot.model_validate(said) if said is not None else None
            if self.print is not None and self.print.phase.ended:
                self.ended.add(self.print.print_id)
        if "filament" in record:
            self.filament = Filament(record["filament"])
        if "look" in record:
            self.look = record["look"]


class Journal:
    """An append-only file. `write` returns when the record is on the disk."""

    def __init__(self, path: Path) -> None:
        self.memory = Memory()
        good = 0
        if path.exists():
            for line in path.read_bytes().splitlines(keepends=True):
                if not line.endswith(b"\n"):
                    break  # cut short by a crash: it was never acted on
                self.memory.take(json.loads(line))
                good += len(line)
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        os.ftruncate(self._fd, good)
        os.lseek(self._fd, 0, os.SEEK_END)

    def write(self, at_s: float, **record: Any) -> None:
        """Put one record on the disk, and take it into `memory`."""
        line = json.dumps({"at_s": round(at_s, 3), **record}) + "\n"
        os.write(self._fd, line.encode())
        os.fsync(self._fd)
        self.memory.take(record)
