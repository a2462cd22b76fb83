"""Abort sequence: it stops motion and heat of a board at once, whatever its line count or its last host.

The sequence is sent before any wait, because a failed reset is noticed only when no answer
arrives in time.

* It begins with a newline; otherwise it would be appended to a line that was cut off.
* `Firmware.stop_command` empties the planner's queue of moves: M401 within 10 ms
  (docs/explanation/ultimaker2-serial.md, section 3.1); then heaters and fan are switched off.
* Its lines have no numbers. The firmware accepts them, and then refuses numbered lines.
* It has no M84, which waits for moves and would block the rest of the sequence if the stop was lost.
* It is short: after M105 and the longest line of a print, it just fits into the firmware's receive buffer of
  127 bytes. A longer sequence would be truncated, and an ``M1`` left over from a truncated M104 would block
  the board forever. So the sequence is repeated only after the board has sent something, which shows that
  it reads.
"""

from __future__ import annotations

import time
from contextlib import suppress

from drivers.errors import PortError
from drivers.firmware import Firmware
from drivers.ports import Port

MAX_ATTEMPTS = 3  # maximum number of times that the sequence is sent
_ANSWER_TIMEOUT_S, _READ_INTERVAL_S = 0.5, 0.05  # wall seconds


def send_abort(port: Port, firmware: Firmware) -> None:
    """Replace all unsent bytes by the sequence, without waiting for an answer. Never raises."""
    with suppress(PortError):
        port.write_now(firmware.unnumbered_abort)


def send_abort_until_accepted(port: Port, firmware: Firmware) -> None:
    """Send the sequence, and again after each refusal, which drops the lines that follow.

    Called by an agent that is shutting down. Takes 0.5 s if nothing is refused; never raises.
    """
    for _ in range(MAX_ATTEMPTS):
        send_abort(port, firmware)
        answer = b""
        with suppress(PortError):
            deadline_s = time.monotonic() + _ANSWER_TIMEOUT_S
            while b"Resend" not in answer and time.monotonic() < deadline_s:
                time.sleep(_READ_INTERVAL_S)
                answer += port.read()
        if b"Resend" not in answer:
            return
