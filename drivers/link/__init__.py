"""The conversation with one board over a serial wire.

Theory of operation (of the Ultimaker 2+: docs/explanation/ultimaker2-serial.md, sections 1, 3 and 7; all of
it holds over a wire that loses and garbles bytes):

1. Lines are numbered and checksummed, and ONE is in flight. The firmware carries out a number once: what is
   sent twice is refused with the number that it wants, so to send the last line again is always safe.
2. That holds for M105 too: a bare one with one flipped bit may be an M1, which never comes back.
3. A plain ``ok`` is the answer to a line, ``ok T:`` that to M105; they are never taken for each other. A
   lost or doubled ok makes the link at most a few lines early or late, until the firmware refuses one.
4. Whatever is uncertain is asked: a line with a checksum and no number (`Firmware.last_line_query`) is
   answered with the number of the last line that was accepted, does nothing, empties no buffer and has no
   ok. It is put after `ASK_S` of silence, after words that cannot be read, and after each refusal; the
   newline before it ends a line that had lost its own. What it says is true of all that was sent before it:
   a line that is missing is sent again, a move that is not had its ok lost. Until then the oks after a
   refusal are void.
5. Silence is no trouble of its own: behind long moves, G28, G4 and M400 the question waits as the line does.
   A line is never sent twice because it was late.
6. A number that is neither that of the line in flight nor the one before has to be said twice. One that is
   not in the history then is that of a board which has lost its count: it was reset.
7. Where more than 5 % of the lines have to be sent again the link gives up: with an 8-bit checksum some of
   the garbled lines would be carried out.

Some firmwares differ, as `Firmware` says. Where the ok of a move comes when it was carried out, an answer may
come before it: a line that was accepted is waited for as long as the board says that it is at work
(`Firmware.keep_alive`). Where the answer to a question is a refusal (`Firmware.last_line_resends`), it has
effect only when all that comes with it was heard: its ok belongs to no line.
"""

from drivers.link.link import Link
from drivers.link.opening import Phase
from drivers.link.outbox import Source
from drivers.link.replies import Event, Events, Report, Said, Trouble, Up

__all__ = ["Event", "Events", "Link", "Phase", "Report", "Said", "Source", "Trouble", "Up"]
