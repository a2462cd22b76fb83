"""The abort sequence: ends motion and heat of a board at once, whatever its line count and its last host.

It is sent before anything is waited for, because a reset that fails is noticed by silence only.

* It begins with a newline, so that a line that was cut off does not swallow it.
* M401 empties the planner's queue of moves within 10 ms (docs/explanation/ultimaker2-serial.md, section 3.1),
  then heaters and fan are switched off.
* It has no line numbers, which the firmware accepts; afterwards it refuses a numbered stream.
* It has no M84: that waits for moves, and would block the rest of the sequence where M401 was lost.
* It is short: with M105 and the longest line of a print in front of it, it fills the firmware's receive
  buffer of 127 bytes. What does not fit is cut, and an ``M1`` left of M104 would block the board for ever. So
  it is repeated only after the board has said something, which shows that it reads.
"""

from __future__ import annotations

import time
from contextlib import suppress

from drivers.errors import PortError
from drivers.firmware import Firmware
from drivers.ports import Port

TRIES = 3
_ANSWER_S, _LOOK_S = 0.5, 0.05  # wall seconds


def send_abort(port: Port, firmware: Firmware) -> None:
    """Send the sequence in place of all unsent bytes, and wait for no answer. Never raises."""
    with suppress(PortError):
        port.write_now(firmware.abort_unnumbered)


def send_abort_until_accepted(port: Port, firmware: Firmware) -> None:
    """Send the sequence, and again where the board refuses a line, which loses the lines behind it.

    For an agent that ends. Takes 0.5 s where nothing is refused. Never raises.
    """
    for _ in range(TRIES):
        send_abort(port, firmware)
        heard = b""
        with suppress(PortError):
            until_s = time.monotonic() + _ANSWER_S
            while b"Resend" not in heard and time.monotonic() < until_s:
                time.sleep(_LOOK_S)
                heard += port.read()
        if b"Resend" not in heard:
            return
