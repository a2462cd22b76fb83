"""Holds: why a plate, or a job that has no plates yet, waits."""

from __future__ import annotations

from enum import StrEnum

from farm.model.entity import Entity


class HoldCode(StrEnum):
    """Reason for which a plate, or a job that has no plates yet, waits."""

    NOT_FRONT = "not_front"
    NO_SUCH_PRINTER = "no_such_printer"
    TOO_FEW_PRINTERS = "too_few_printers"
    PRINTER_BUSY = "printer_busy"
    ALL_ITS_PRINTERS_BUSY = "all_its_printers_busy"
    BED_NOT_CLEAR = "bed_not_clear"
    REEL_DOUBTED = "reel_doubted"  # nobody knows what the restored books do not tell
    FILAMENT_UNKNOWN = "filament_unknown"
    NEEDS_A_LOOK = "needs_a_look"
    PRINTER_ABSENT = "printer_absent"
    PRINTER_CONNECTING = "printer_connecting"
    REEL_TOO_SHORT = "reel_too_short"
    START_TIME = "start_time"  # its job starts later (--at, --overnight)
    QUIET_HOURS = "quiet_hours"
    UNATTENDED = "unattended"  # somebody has to be there
    TOO_LONG = "too_long"  # for the hours of fleet.yaml
    HEATING_LIMIT = "heating_limit"
    KEPT_AS_SPARE = "kept_as_spare"
    UNTOLD = "untold"  # a printer has not said what it printed since the books were copied
    APPROVAL = "approval"  # `farm approve` lets it begin
    MAINTENANCE = "maintenance"
    PAUSED = "paused"
    STOPPED = (
        "stopped"  # a person stopped its print by `farm estop`, and has not said that it may begin again
    )
    OUT_OF_ATTEMPTS = "out_of_attempts"
    CUT_AGAIN = "cut_again"  # it failed, and its part is being recut for several printers
    JUST_LOST = "just_lost"
    OUTAGE = "outage"


class ShortReel(Entity):
    """Printer that would take a plate if it had more filament, and how much it has and needs."""

    printer: str
    text: str


class Hold(Entity):
    """Reason to wait: a code, and a sentence that may change while the reason stays."""

    code: HoldCode
    text: str
    reel: ShortReel | None = None

    def same_reason(self, other: Hold | None) -> bool:
        """Tell whether another hold differs in its sentence alone (a time, a printer)."""
        return other is not None and (self.code, self.reel) == (other.code, other.reel)
