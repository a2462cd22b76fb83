"""Rules for starting a print: hours, the heating limit, and enough filament on the reel. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, tzinfo
from zoneinfo import ZoneInfo

from farm.config import FleetSection
from farm.model import Hold, HoldCode, ShortReel, TextTime
from farm.scheduling.hours import Hours
from farm.scheduling.matching import FleetPrinter, WaitingPlate
from farm.text import format_duration
from farm.wording import make_text_time

DELAY_FACTOR = 1.05
"""Allowance for delays: a print may take this multiple of its expected time."""
GRAMS_RATIO, MIN_RESERVE_GRAMS = 1.05, 5.0
"""Filament that a reel must have for a plate: this multiple of the plate's grams, and at least this many
grams more."""
FIRST_LAYERS_RESERVE_S = 3600.0
"""Seconds at the end of the attended hours that are reserved for first layers, which need supervision."""
CLEARING_RESERVE_S = 900.0
"""Seconds of the attended hours that are reserved to cool and clear the bed after an attended print."""
_HORIZON_S = 15 * 86400.0  # hours repeat weekly, so a plate that cannot start within this time never can
_TOLERANCE_S = 0.001  # a plate may still start exactly at its latest start


@dataclass(frozen=True, slots=True)
class Start:
    """Earliest time at which a plate may start on a printer.

    Attributes
    ----------
    at_s
        Seconds since the epoch; None for never.
    reason
        Reason to wait until then; None if it may start immediately.
    """

    at_s: float | None
    reason: Hold | None = None


@dataclass(frozen=True, slots=True)
class StartWindow:
    """Limits that attended and quiet hours set on prints that start at a given time.

    The limits are the same on all printers with the same `may_print_unattended`.

    Attributes
    ----------
    at_s
        The start time.
    quiet_start_s
        Start of the current or next quiet hours.
    attended_end_s
        End of the attended hours; minus infinity outside of them.
    may_print_unattended
        True if the printers may print while nobody is present.
    first_layers_attended
        True if first layers must be printed in attended hours.
    """

    at_s: float
    quiet_start_s: float
    attended_end_s: float
    may_print_unattended: bool
    first_layers_attended: bool

    def allows(self, plate: WaitingPlate) -> bool:
        """Return whether a plate may start, by the same rules as `StartRules.find_start`."""
        at_s = self.at_s
        if plate.not_before_s is not None and plate.not_before_s > at_s:
            return False
        if at_s + plate.expected_s * DELAY_FACTOR > self.quiet_start_s:
            return False
        if not self.may_print_unattended:
            return at_s + (plate.expected_s * DELAY_FACTOR + CLEARING_RESERVE_S) <= self.attended_end_s
        return not self.first_layers_attended or at_s + plate.first_layer_s <= self.attended_end_s


@dataclass(frozen=True, slots=True)
class StartRules:
    """Rules of `fleet.yaml`: attended and quiet hours, and the limit on printers that are heating."""

    attended_hours: Hours
    quiet_hours: Hours
    first_layers_attended: bool = False
    max_heating: int | None = None

    @staticmethod
    def from_config(section: FleetSection) -> StartRules:
        zone = ZoneInfo(section.timezone)
        return StartRules(
            attended_hours=Hours(section.attended, zone),
            quiet_hours=Hours(section.quiet, zone),
            first_layers_attended=section.first_layers_attended,
            max_heating=section.max_heating,
        )

    @property
    def zone(self) -> tzinfo:
        return self.attended_hours.zone

    def format_moment(self, at_s: float, now_s: float) -> str:
        """Format a time for users, like `Fri 22:00`; with its date if it is more than six days from now."""
        return self.make_text_time(at_s, now_s).text

    def make_text_time(self, at_s: float, now_s: float) -> TextTime:
        """Return a time with its text in a sentence; see `format_moment`."""
        return make_text_time(at_s, now_s, self.zone)

    def find_start(self, plate: WaitingPlate, printer: FleetPrinter, earliest_s: float) -> Start:
        """Find the first time, not before `earliest_s`, at which a plate may start on a printer.

        A print must end before quiet hours begin. If it needs a person, it must start in attended hours.
        """
        at_s, reason = earliest_s, None
        if plate.not_before_s is not None and plate.not_before_s > at_s:
            at_s = plate.not_before_s
            reason = self.make_start_hold(at_s, earliest_s)
        while at_s < earliest_s + _HORIZON_S:
            for start in (
                self._skip_quiet_hours(plate, at_s, earliest_s),
                self._find_attended_start(plate, printer, at_s, earliest_s),
            ):
                if start is not None:
                    break
            else:
                return Start(at_s, reason)
            reason = start.reason
            if start.at_s is None:
                return start
            at_s = start.at_s
        text = f"it takes {format_duration(plate.expected_s)}: longer than the hours in fleet.yaml ever allow"
        return Start(None, Hold(code=HoldCode.TOO_LONG, text=text))

    def make_start_hold(self, at_s: float, now_s: float) -> Hold:
        """Return the hold of a plate whose job starts later."""
        start = self.make_text_time(at_s, now_s)
        return Hold(code=HoldCode.START_TIME, text=f"its job starts {start.text}", times=(start,))

    def find_start_window(self, may_print_unattended: bool, at_s: float) -> StartWindow:
        """Return the limits on prints that start at `at_s` on printers with this permission."""
        quiet_span = self.quiet_hours.find_span(at_s) or self.quiet_hours.find_next_span(at_s)
        attended_span = self.attended_hours.find_span(at_s)
        return StartWindow(
            at_s=at_s,
            quiet_start_s=math.inf if quiet_span is None else quiet_span[0],
            attended_end_s=-math.inf if attended_span is None else attended_span[1],
            may_print_unattended=may_print_unattended,
            first_layers_attended=self.first_layers_attended,
        )

    def _skip_quiet_hours(self, plate: WaitingPlate, at_s: float, now_s: float) -> Start | None:
        """Return a start after the quiet hours if a print from `at_s` would run into them; else None."""
        quiet_span = self.quiet_hours.find_span(at_s) or self.quiet_hours.find_next_span(at_s)
        if quiet_span is None or at_s + plate.expected_s * DELAY_FACTOR <= quiet_span[0]:
            return None
        if quiet_span[1] == float("inf"):
            return Start(None, Hold(code=HoldCode.QUIET_HOURS, text="fleet.yaml has quiet hours all week"))
        start, end = times = tuple(self.make_text_time(at_s, now_s) for at_s in quiet_span)
        duration = format_duration(plate.expected_s)
        text = f"it takes {duration}, and quiet hours are from {start.text} to {end.text}"
        return Start(quiet_span[1], Hold(code=HoldCode.QUIET_HOURS, text=text, times=times))

    def _find_attended_start(
        self, plate: WaitingPlate, printer: FleetPrinter, at_s: float, now_s: float
    ) -> Start | None:
        """Return a start in the next attended hours; None if a print may start at `at_s`."""
        needed_s = self._compute_attendance_s(plate, printer)
        if needed_s is None:
            return None
        rule = "first layers are printed only in attended hours"
        if not printer.may_print_unattended:
            rule = f"{printer.name} prints only in attended hours ({printer.attended_reason})"
        span = self.attended_hours.find_span(at_s)
        if span is not None and at_s + needed_s <= span[1]:
            return None
        next_span = self.attended_hours.find_next_span(at_s)
        if next_span is None:
            text = f"{rule}, and fleet.yaml has none (`attended`)"
            return Start(None, Hold(code=HoldCode.UNATTENDED, text=text))
        start = self.make_text_time(next_span[0], now_s)
        hold = Hold(code=HoldCode.UNATTENDED, text=f"{rule}: from {start.text}", times=(start,))
        return Start(next_span[0], hold)

    def _compute_attendance_s(self, plate: WaitingPlate, printer: FleetPrinter) -> float | None:
        """Return the seconds from its start during which a print needs a person; None if it needs nobody."""
        if not printer.may_print_unattended:
            return plate.expected_s * DELAY_FACTOR + CLEARING_RESERVE_S
        return plate.first_layer_s if self.first_layers_attended else None

    def find_latest_start_s(self, plate: WaitingPlate, printer: FleetPrinter, at_s: float) -> float:
        """Return the latest start of a plate that may start at `at_s`; infinity for no limit."""
        return min(self._list_latest_starts_s([plate], [printer], at_s))

    def _list_latest_starts_s(
        self, plates: Iterable[WaitingPlate], printers: Collection[FleetPrinter], at_s: float
    ) -> Iterator[float]:
        """Yield the latest start in the hours around `at_s` for each plate on each printer."""
        quiet_span, attended_span = self.quiet_hours.find_next_span(at_s), self.attended_hours.find_span(at_s)
        for plate in plates:
            before_quiet_s = (
                math.inf if quiet_span is None else quiet_span[0] - plate.expected_s * DELAY_FACTOR
            )
            for printer in printers:
                needed_s = self._compute_attendance_s(plate, printer)
                if needed_s is None or attended_span is None:
                    yield before_quiet_s
                else:
                    yield min(before_quiet_s, attended_span[1] - needed_s)

    def find_next_change_s(
        self, plates: Collection[WaitingPlate], printers: Iterable[FleetPrinter], now_s: float
    ) -> float:
        """Return the next time at which other plates may start because of the hours; infinity for never.

        At that time, attended or quiet hours begin or end, or a plate reaches its latest start.
        """
        # `may_print_unattended` is the only field of a printer on which the allowed hours depend.
        kinds = {printer.may_print_unattended: printer for printer in printers}
        times_s = [self.attended_hours.find_next_edge_s(now_s), self.quiet_hours.find_next_edge_s(now_s)]
        if self.quiet_hours.windows or self.attended_hours.windows:
            times_s += [
                at_s + _TOLERANCE_S for at_s in self._list_latest_starts_s(plates, kinds.values(), now_s)
            ]
        return min((at_s for at_s in times_s if at_s is not None and at_s > now_s), default=math.inf)

    def find_latest_end_s(self, printer: FleetPrinter, at_s: float) -> float | None:
        """Return the latest end of a print that runs at `at_s`; None for no limit."""
        if printer.may_print_unattended:
            return None
        span = self.attended_hours.find_span(at_s)
        if span is not None and math.isinf(span[1]):
            return None
        return at_s if span is None else span[1] - CLEARING_RESERVE_S

    def find_unattended_reason(self, printer: FleetPrinter, now_s: float) -> str | None:
        """Return the reason why a printer may not continue printing now; None if it may."""
        latest_end_s = self.find_latest_end_s(printer, now_s)
        if latest_end_s is None or now_s < latest_end_s:
            return None
        next_span = self.attended_hours.find_next_span(now_s)
        hint = "" if next_span is None else f": from {self.format_moment(next_span[0], now_s)} ({self.zone})"
        return f"{printer.name} prints only in attended hours ({printer.attended_reason}){hint}"

    def find_night_start_s(self, now_s: float) -> float | None:
        """Return the start of the night, which is the end of the attended hours; None if it is night now.

        Raises
        ------
        ValueError
            If fleet.yaml has no attended hours, or hours that never end, or requires attended first layers.
        """
        if not self.attended_hours.windows:
            raise ValueError("--overnight needs `attended` hours in fleet.yaml")
        span = self.attended_hours.find_span(now_s)
        if span is not None and math.isinf(span[1]):
            raise ValueError(
                "--overnight starts when nobody is there, and the `attended` hours of fleet.yaml never end: "
                "use --at TIME"
            )
        if self.first_layers_attended:
            while span is not None and span[1] - FIRST_LAYERS_RESERVE_S <= now_s:
                span = self.attended_hours.find_next_span(span[1])
            span = span or self.attended_hours.find_next_span(now_s)
            latest = (
                None if span is None else datetime.fromtimestamp(span[1] - FIRST_LAYERS_RESERVE_S, self.zone)
            )
            example = "" if latest is None else f", like --at '{latest:%a %H:%M}'"
            raise ValueError(
                "--overnight starts when nobody is there, but fleet.yaml requires attended first layers "
                f"(`first_layers_attended`): use --at with a time before attended hours end{example}"
            )
        return None if span is None else span[1]

    def is_attended(self, at_s: float) -> bool:
        """Return whether a time is within the attended hours; False if fleet.yaml has none."""
        return self.attended_hours.find_span(at_s) is not None

    def find_clearing_end_s(self, ended_s: float, clearing_s: float) -> float:
        """Return the earliest time by which a person can have cleared the bed after a print."""
        if not self.attended_hours.windows or self.attended_hours.find_span(ended_s) is not None:
            return ended_s + clearing_s
        next_span = self.attended_hours.find_next_span(ended_s)
        return (next_span[0] if next_span is not None else ended_s) + clearing_s


def compute_needed_grams(plate: WaitingPlate) -> float:
    """Return the grams that a reel must have for a plate, including the reserve."""
    return max(plate.grams * GRAMS_RATIO, plate.grams + MIN_RESERVE_GRAMS)


def find_filament_shortage(plate: WaitingPlate, printer: FleetPrinter) -> Hold | None:
    """Return a hold if a printer's reel has too few grams for a plate; None if enough or unknown."""
    grams_needed = compute_needed_grams(plate)
    if printer.grams is None or printer.grams >= grams_needed:
        return None
    stock, need = f"{printer.name} has {printer.grams:.0f} g", f"needs {grams_needed:.0f} g"
    return Hold(
        code=HoldCode.REEL_TOO_SHORT,
        text=f"{stock}, but this plate {need}: load a reel, then `farm load {printer.name}`",
        reel=ShortReel(printer=printer.name, text=f"{stock}, {plate.name or plate.id} {need}"),
    )
