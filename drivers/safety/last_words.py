"""Words that end motion and heat of a board at once, whatever it counts and whoever spoke to it before.

They are sent before anything is waited for, as a reset that does not get through is noticed by silence only.

* A newline first: a line that was cut off must not swallow them.
* M401 empties the planner's queue of moves within 10 ms (docs/explanation/ultimaker2-serial.md, section 3.1),
  then heaters and fan go off.
* They have no numbers, which the firmware takes as they are; a numbered stream is refused after them.
* No M84: it waits for moves, and would hold up what comes behind it where M401 was lost.
* They are short: with M105 and the longest line of a print in front they fill the firmware's receive ring of
  127 bytes and no more. It cuts what does not fit, and an ``M1`` left of M104 would never come back. So they
  are sent again only when the board has said something, which shows that it reads.
"""

from __future__ import annotations

import time
from contextlib import suppress

from drivers.errors import PortError
from drivers.firmware import Firmware
from drivers.ports.port import Port

TRIES = 3
_ANSWER_S, _LOOK_S = 0.5, 0.05  # wall seconds


def end_blind(port: Port, firmware: Firmware) -> None:
    """Send the last words and wait for nothing. Never raises; what was not sent before is forgotten."""
    with suppress(PortError):
        port.write_now(firmware.abort_unnumbered)


def end_heard(port: Port, firmware: Firmware) -> None:
    """Send them, and again where the board refuses a line, which loses all that came with it. Never raises.

    For an agent that ends: takes 0.5 s where nothing is refused.
    """
    for _ in range(TRIES):
        end_blind(port, firmware)
        heard = b""
        with suppress(PortError):
            until_s = time.monotonic() + _ANSWER_S
            while b"Resend" not in heard and time.monotonic() < until_s:
                time.sleep(_LOOK_S)
                heard += port.read()
        if b"Resend" not in heard:
            return
