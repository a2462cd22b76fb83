"""Link to one board over a serial line.

Theory of operation for the Ultimaker 2+ (docs/explanation/ultimaker2-serial.md, sections 1, 3 and 7). All of
it holds even if the wire loses and garbles bytes:

1. Lines have a number and a checksum, and only ONE is in flight. The firmware executes each number once: a
   line that is sent twice is refused with the number it expects, so resending the last line is always safe.
2. M105 is numbered too: without a checksum, one flipped bit may turn it into M1, which never returns.
3. A plain ``ok`` acknowledges a line, and ``ok T:`` answers M105; the two are never confused. After a lost or
   doubled ok, the link is at most a few lines ahead or behind, until the firmware refuses a line.
4. When in doubt, the link queries the board: a line with a checksum and no number
   (`Firmware.last_line_query`) is answered with the number of the last accepted line. It has no other
   effect and no ok. The query is sent after `SILENCE_S` of silence, after an unreadable line and after each
   refusal; its leading newline ends a line that lost its own newline. The answer covers everything sent
   before the query: if a line is missing, it is sent again; if a move arrived, its ok was lost. Until the
   answer arrives, oks after a refusal are ignored.
5. Silence alone is not a fault: behind long moves, G28, G4 and M400, the query waits just as the line does. A
   line is never resent because its ok is late.
6. The board must report a number twice before the link accepts it, unless it is that of the line in flight or
   of the line before. If that number is not in the history, the board has lost its line count: it was reset.
7. If more than 5 % of the lines have to be resent, the link gives up: with an 8-bit checksum some of the
   garbled lines would be executed.

`Firmware` records the differences between firmwares. If a move is acknowledged only after execution, the
answer to a query may arrive before the move's ok: the link waits for that ok as long as the board reports
that it is busy (`Firmware.busy_prefix`). If the answer to a query is a refusal
(`Firmware.last_line_query_causes_resend`), the link acts on it only after all of its lines have
arrived, as its ok acknowledges no line.
"""

from drivers.link.link import Link
from drivers.link.opening import Phase
from drivers.link.outbox import Source
from drivers.link.replies import BoardConnected, Event, Events, LinkFault, Report, UnknownLine

__all__ = [
    "BoardConnected",
    "Event",
    "Events",
    "Link",
    "LinkFault",
    "Phase",
    "Report",
    "Source",
    "UnknownLine",
]
