"""Which printer a session talks to: two swapped cables must not heat the wrong one. Pure."""

from __future__ import annotations

from collections.abc import Generator

from drivers.errors import Fault
from drivers.gcode.program import Program
from drivers.link import replies
from drivers.link.link import Link
from drivers.messages import Filament
from drivers.printers.profiles import Profile
from drivers.session.park import Parking
from drivers.session.steps import TRIES, Ended, Pace, Script, Wait

HOME_SLACK_MM = 30.0  # M206 shifts what a printer calls the height of its home


class Identifying(Parking):
    """Steps that look whether it is the right printer.

    Attributes
    ----------
    identity
        What its banner says of this very printer; None where nobody has seen it yet.
    """

    def __init__(
        self,
        link: Link,
        program: Program | None,
        profile: Profile,
        filament: Filament,
        pace: Pace,
        now_s: float,
        identity: str | None,
    ) -> None:
        super().__init__(link, program, profile, filament, pace, now_s)
        self.identity = identity
        self._said = b""  # by the board, since the last question

    def _identify(self) -> Script:
        """Reset the board and see that it is this printer's; before anything heats.

        A banner carries no checksum: what cannot be read, or is another's, is asked for again.
        """
        wrong = ""
        for _ in range(TRIES):
            yield from self._connect()
            assert self._up is not None
            found = replies.identity(self._up.banner)
            if not self._up.restarted:  # the height of its home tells an Extended
                settings = yield from self._answer(b"M503")
                offset = replies.offset(settings)
                found = None if offset is None else replies.Identity(self.profile.banner_suffix, offset)
            if found is None:
                wrong = "its banner does not tell which printer it is"
            elif found.suffix != self.profile.banner_suffix:
                wrong = f"not the board of an {self.profile.title}"
            elif self.identity is not None and found.offset != self.identity:
                wrong = f"another printer, or levelled anew: home offset {found.offset}, not {self.identity}"
            elif b"Ultimaker2" in (yield from self._answer(b"M115")):
                self.identity = found.offset
                return
            else:
                wrong = "M115 tells of another firmware than the Ultimaker 2's"
        raise Ended(Fault.WRONG_PRINTER, wrong)

    def _answer(self, question: bytes) -> Generator[Wait, bool, bytes]:
        """What the board says to a question."""
        self._said = b""
        yield from self._commands(question)
        return self._said

    def _check_height(self, home: bytes) -> Script:
        """An Extended is 100 mm higher, whatever its firmware says; `home` is the file's first G28."""
        if home != b"G28" and b"Z" not in home:
            return
        self._place = None
        yield from self._commands(b"M114")
        home_mm = self.profile.home_mm[2]
        if self._place is not None and abs(self._place[2] - home_mm) > HOME_SLACK_MM:
            raise Ended(
                Fault.WRONG_PRINTER,
                f"its bed homes at {self._place[2]:g} mm, not near {home_mm:g}: not an {self.profile.title}",
            )
