"""Holds: reasons why a plate, or a job that has no plates yet, waits."""

from __future__ import annotations

from enum import StrEnum

from farm.model.entity import Entity


class HoldCode(StrEnum):
    """Reason why a plate, or a job that has no plates yet, waits."""

    NOT_FIRST = "not_front"  # other jobs in the queue are planned first
    NO_SUCH_PRINTER = "no_such_printer"
    TOO_FEW_PRINTERS = "too_few_printers"  # only in holds of earlier versions, which ignored busy printers
    PRINTER_BUSY = "printer_busy"
    JOB_PRINTER_LIMIT = "all_its_printers_busy"
    BED_NOT_CLEAR = "bed_not_clear"
    REEL_UNCERTAIN = (
        "reel_doubted"  # the database was restored: prints since the backup may have used filament
    )
    FILAMENT_UNKNOWN = "filament_unknown"
    NEEDS_INSPECTION = "needs_a_look"
    PRINTER_ABSENT = "printer_absent"
    PRINTER_CONNECTING = "printer_connecting"
    REEL_TOO_SHORT = "reel_too_short"
    START_TIME = "start_time"  # its job starts later (`--at`, `--overnight`)
    QUIET_HOURS = "quiet_hours"
    UNATTENDED = "unattended"  # may print only while a person is present
    TOO_LONG = "too_long"  # longer than any time window in fleet.yaml
    HEATING_LIMIT = "heating_limit"
    KEPT_AS_SPARE = "kept_as_spare"  # the idle printer is kept in reserve for a failed part
    PRINTER_UNREPORTED = "untold"  # a printer has not reported its prints since the backup
    APPROVAL = "approval"  # its job waits for `farm approve`
    MAINTENANCE = "maintenance"
    PAUSED = "paused"
    STOPPED = "stopped"  # its print was stopped by `farm estop`; waits for `farm resume`
    OUT_OF_ATTEMPTS = "out_of_attempts"
    BEING_RECUT = "cut_again"  # its part failed and is being cut for several printers
    BEING_REPLANNED = "planned_again"  # its job is planned for other printers, before it starts
    JUST_LOST = "just_lost"  # its printer was lost a moment ago; other printers may be lost too
    OUTAGE = "outage"  # several printers were lost together; all plates wait for `farm resume`


class ShortReel(Entity):
    """Reel with too little filament for a plate: its printer, and a text with the amounts left and needed."""

    printer: str
    text: str


class TextTime(Entity):
    """Time that a sentence mentions: its text, in the farm's time zone, and the same time in ISO 8601."""

    text: str
    at: str


class Hold(Entity):
    """Reason to wait: a code, and a sentence whose wording may change while the reason stays."""

    code: HoldCode
    text: str
    reel: ShortReel | None = None
    times: tuple[TextTime, ...] = ()

    def has_same_reason(self, other: Hold | None) -> bool:
        """Return whether another hold has the same code and reel; its sentence may differ."""
        return other is not None and (self.code, self.reel) == (other.code, other.reel)
