"""Opening of a link: the phase from opening the port until the board answers. Pure."""

from __future__ import annotations

from enum import Enum, StrEnum

from drivers.firmware import Firmware
from drivers.link.recovery import MAX_ATTEMPTS

# Maximum time from the opening of the port to ``start``; the bootloader takes one second.
START_TIMEOUT_S = 10.0
# Time until the first query if the board may not restart.
UNCONFIRMED_QUERY_DELAY_S = 0.3
BANNER_TIMEOUT_S = 1.0  # time for the rest of the banner after ``start``


class Phase(StrEnum):
    """Phase of the connection to a board."""

    CLOSED = "closed"
    OPENING = "opening"  # waits for ``start``
    BANNER = "banner"  # waits for the end of the banner
    LIVE = "live"
    DEAD = "dead"  # after a fault: sends nothing, ignores everything


class OpeningLine(Enum):
    """Meaning of a line while the port opens."""

    NOTHING = 0
    BANNER = 1  # the banner begins or continues
    READY = 2  # the banner has ended, or a board that did not restart answers
    REFUSAL = 3  # the unconfirmed commands may be lost


class Opening:
    """Opening of one port.

    Parameters
    ----------
    firmware
        The board's firmware.
    min_timeout_s
        See `Link`.
    unconfirmed_commands
        Commands that were sent before; a board that does not restart must have received them.

    Attributes
    ----------
    has_restarted, banner
        True if the board sent ``start``; the lines that followed it.
    is_refused
        True if the unconfirmed commands may be lost.
    """

    def __init__(self, firmware: Firmware, min_timeout_s: float, unconfirmed_commands: bytes = b"") -> None:
        self.has_restarted = False
        self.banner = b""
        self.is_refused = False
        self._firmware, self._min_timeout_s = firmware, min_timeout_s
        self._unconfirmed_commands = unconfirmed_commands
        self._query_count = 0

    @property
    def first_query_delay_s(self) -> float:
        """Seconds to wait for ``start`` before the first query."""
        return (
            max(UNCONFIRMED_QUERY_DELAY_S, self._min_timeout_s / 8)
            if self._unconfirmed_commands
            else max(START_TIMEOUT_S, self._min_timeout_s)
        )

    @property
    def banner_timeout_s(self) -> float:
        """Seconds to wait for the rest of a banner."""
        return max(BANNER_TIMEOUT_S, self._min_timeout_s / 4)

    @property
    def answer_timeout_s(self) -> float:
        """Seconds to wait for the answer to a query."""
        return max(
            START_TIMEOUT_S if self._unconfirmed_commands else START_TIMEOUT_S / 2, self._min_timeout_s
        )

    def classify_line(self, line: bytes) -> OpeningLine:
        """Classify a line from the board."""
        if line.endswith(b"start"):  # a reset may put noise in front of it
            self.has_restarted, self.banner = True, b""
            return OpeningLine.BANNER
        if self.has_restarted:
            self.banner += line + b"\n"
            end = self._firmware.banner_end
            if end is None:
                return OpeningLine.BANNER
            return OpeningLine.READY if end in line else OpeningLine.NOTHING
        if self._unconfirmed_commands and b"Resend" in line:
            self.is_refused = True
            return OpeningLine.REFUSAL
        ok = b"ok T:" if self._unconfirmed_commands else b"ok"
        is_answer = line.startswith(ok) and self._query_count > 0
        return OpeningLine.READY if is_answer else OpeningLine.NOTHING

    def take_next_query(self) -> bytes | None:
        """Return the next query for a board that did not restart; None after the last one."""
        self._query_count += 1
        if self._query_count > MAX_ATTEMPTS:
            return None
        commands = self._unconfirmed_commands if self.is_refused or self._query_count > 1 else b""
        self.is_refused = False
        return commands + self._firmware.report_query + b"\n"
