"""Host of the emulated firmware, in one process and on a clock that the test advances."""

from __future__ import annotations

import random
from functools import reduce
from operator import xor

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.printers import PROFILES


class Host:
    """Host at the other end of the serial line, with a controlled clock."""

    def __init__(
        self, model: str = "ultimaker2_plus", faults: Faults | None = None, boot: bool = True
    ) -> None:
        self.firmware = EmulatedFirmware(PROFILES[model], faults or Faults(), random.Random(1), 0.0)
        self.board = self.firmware.board
        self.now_s = 0.0
        self.last_number = 0
        if boot:
            self.wait(5.0)

    def wait(self, seconds: float) -> list[str]:
        """Return the lines that the firmware sends in the next seconds."""
        return self.wait_until(self.now_s + seconds)

    def wait_until(self, end_s: float) -> list[str]:
        data = b""
        while (due_s := self.firmware.compute_deadline_s()) <= end_s:
            self.now_s = max(self.now_s, due_s)
            data += self.firmware.feed(b"", self.now_s)
        self.now_s = end_s
        data += self.firmware.feed(b"", end_s)
        return data.decode("latin-1").splitlines()

    def send_burst(self, *lines: str) -> list[str]:
        """Send lines in one burst, and return the immediate answers."""
        data = "".join(f"{line}\n" for line in lines).encode("latin-1")
        return self.firmware.feed(data, self.now_s).decode("latin-1").splitlines()

    def send(self, line: str, seconds: float = 600.0) -> list[str]:
        """Send a line and wait for its ok, which may follow other text on the same line."""
        answers = self.send_burst(line)
        end_s = self.now_s + seconds
        while not any(text.endswith("ok") or text.startswith("ok") for text in answers):
            due_s = self.firmware.compute_deadline_s()
            assert due_s <= end_s, f"no ok to {line!r}, only {answers}"
            answers += self.wait_until(due_s)
        return answers

    def send_numbered(self, body: str) -> list[str]:
        """Send a line with its number and checksum, and wait for its ok."""
        self.last_number += 1
        return self.send(add_number(self.last_number, body))

    def heat_nozzle(self, nozzle_c: float = 210.0) -> None:
        self.send(f"M109 S{nozzle_c}")


def add_number(n: int, body: str) -> str:
    line = f"N{n} {body}"
    return f"{line}*{reduce(xor, line.encode())}"
