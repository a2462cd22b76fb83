"""Why a plate waits: a code and a sentence with what would end it. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import Hold, HoldCode
from farm.scheduling.situation import Kind, PlateView, PrinterView
from farm.scheduling.spares import takes_spare
from farm.scheduling.start_rules import Rules, short_of_filament

_NAMED = 4  # printers that a sentence names; the rest is counted


class Reasons:
    """The reasons at one moment.

    Parameters
    ----------
    fleet
        By name.
    given
        Printers that get a plate now.
    kept
        Free printers that are kept for plates that failed elsewhere.
    full
        The most printers that may heat at once, where as many do.
    """

    def __init__(
        self,
        fleet: dict[str, PrinterView],
        given: frozenset[str],
        kept: frozenset[str],
        rules: Rules,
        now_s: float,
        full: int | None,
    ) -> None:
        self._fleet, self._given, self._kept = fleet, given, kept
        self._rules, self._now_s, self._full = rules, now_s, full
        self._obstacles = {name: printer.obstacle() for name, printer in fleet.items()}
        self._kinds = tuple(dict.fromkeys(printer.kind for printer in fleet.values()))
        self._having: dict[tuple[Kind, ...], tuple[str, ...]] = {}  # the printers that are not of these kinds
        self._busy: dict[tuple[str, ...], Hold | None] = {}
        self._idle = frozenset(n for n, hold in self._obstacles.items() if hold is None) - given

    def no_place(self) -> Hold:
        return Hold(
            code=HoldCode.ALL_ITS_PRINTERS_BUSY,
            text="its job prints on as many printers as it was given (--printers)",
        )

    def why(self, plate: PlateView) -> Hold:
        """Why it waits. What ends by itself comes first, with what a person could do to end it sooner."""
        lacking = tuple(kind for kind in self._kinds if not plate.need.matches(kind))
        if lacking not in self._having:
            self._having[lacking] = tuple(n for n, p in self._fleet.items() if p.kind not in lacking)
        names = self._having[lacking]
        if not names:
            asked = plate.need.words() or "nothing asked"
            return Hold(code=HoldCode.NO_SUCH_PRINTER, text=f"no printer of the fleet matches: {asked}")
        needs = plate.need.words(lacking) if lacking else ""
        hold = self._among(plate, names)
        return hold.model_copy(update={"text": f"needs {needs}: {hold.text}"}) if needs else hold

    def _among(self, plate: PlateView, names: tuple[str, ...]) -> Hold:
        short: Hold | None = None
        for name in names if self._idle else ():
            held = self._held(plate, name) if name in self._idle else None
            if held is not None and held.code is not HoldCode.REEL_TOO_SHORT:
                return held  # it passes by itself
            short = short or held
        busy = self._printing(names)
        if busy is not None:
            return Hold(code=busy.code, text=f"{busy.text}; {short.text}", reel=short.reel) if short else busy
        planned = self._obstacles.get(plate.planned) if plate.planned in names else None
        first = next((hold for n in names if (hold := self._obstacles[n]) is not None), None)
        return planned or short or first or _given_away()

    def _held(self, plate: PlateView, name: str) -> Hold | None:
        """Why it does not go to a printer that is idle and clear."""
        printer = self._fleet[name]
        short = short_of_filament(plate, printer, printer.grams)
        if short is not None:
            return short
        start = self._rules.start(plate, printer, self._now_s)
        if start.at_s != self._now_s:
            return start.why
        if name in self._kept and not takes_spare(plate, self._fleet):
            return Hold(code=HoldCode.KEPT_AS_SPARE, text=f"{name} is kept for a plate that fails (--spares)")
        if self._full is not None:
            return Hold(
                code=HoldCode.HEATING_LIMIT,
                text=f"{self._full} printers heat already: more at once are too much (max_heating)",
            )
        return None

    def _printing(self, names: tuple[str, ...]) -> Hold | None:
        """Which of these print, until when the first of them does, and what could be used before that."""
        if names not in self._busy:
            self._busy[names] = self._printing_now(names)
        return self._busy[names]

    def _printing_now(self, names: tuple[str, ...]) -> Hold | None:
        obstacles = {n: hold for n in names if (hold := self._obstacles[n]) is not None}
        busy = [n for n, hold in obstacles.items() if hold.code is HoldCode.PRINTER_BUSY]
        if not busy:
            return _given_away() if any(n in self._given for n in names) else None
        ends = [end for n in busy if (end := self._fleet[n].free_s) is not None and end > self._now_s]
        until = f" until {self._rules.words(min(ends))}" if ends else ""
        text = f"{listed(busy)} {'is' if len(busy) == 1 else 'are'} printing{until}"
        full = [n for n, hold in obstacles.items() if hold.code is HoldCode.BED_NOT_CLEAR]
        if full:
            text += f"; `farm cleared {full[0]}` would let it begin now, if that bed is clear"
        return Hold(code=HoldCode.PRINTER_BUSY, text=text)


def _given_away() -> Hold:
    return Hold(code=HoldCode.PRINTER_BUSY, text="every matching printer was given another plate")


def listed(names: Iterable[str]) -> str:
    """Names in a sentence: a, b and c; many are counted."""
    *rest, last = names
    if len(rest) >= _NAMED:
        rest, last = rest[: _NAMED - 1], f"{len(rest) - _NAMED + 2} more"
    return f"{', '.join(rest)} and {last}" if rest else last
