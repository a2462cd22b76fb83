"""Table of the printers on the status page."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from farm import api
from farm.cli.display.table import Column, lay_out_table
from farm.model import Bed, HoldCode, Link, PrintState
from farm.text import format_duration, format_recent_moment
from farm.wording import describe_material, format_deviation, format_share, parse_time

_COLUMNS = (
    Column("PRINTER"),
    Column("STATE"),
    Column("PART"),
    Column("ENDS"),
    Column("VS PLAN", rank=3),
    Column("FACTOR", rank=6),
    Column("REEL", rank=2, min_width=9),
    Column("NOZZLE", rank=4),
    Column("BED", rank=5),
    Column("ACTION", rank=1, min_width=18),
)
_STATE_NAMES = {"look": "inspect"}  # a person must inspect the printer
"""States whose names in the table differ from those in `--json`."""


def lay_out_printers(printers: Sequence[api.PrinterView], now: str, width: int | None) -> list[Text]:
    """Lay out the table of printers; its first line has the headings."""
    return lay_out_table(_COLUMNS, [_list_cells(printer, now) for printer in printers], width)


def compute_urgency_s(printer: api.PrinterView) -> float:
    """Return the seconds until a print ends; -1 if a person has to act, infinity if idle."""
    needs_person = printer.hold is not None or printer.state == PrintState.PAUSED
    if needs_person and _format_action(printer):
        return -1.0
    return printer.print.remaining_s if printer.print is not None else float("inf")


def _list_cells(printer: api.PrinterView, now: str) -> tuple[str, ...]:
    part, ends, deviation = "", "", ""
    state, last_print = _STATE_NAMES.get(printer.state, printer.state), printer.last
    if printer.print is not None:
        part = printer.print.name
        ends = f"in {format_duration(printer.print.remaining_s)} ({format_share(printer.print.progress)})"
    elif last_print is not None and printer.bed != Bed.CLEAR:
        end_time = (
            "-"
            if last_print.ended is None
            else format_recent_moment(parse_time(last_print.ended), parse_time(now))
        )
        part, ends = last_print.name, f"at {end_time}"
        deviation = format_deviation(last_print.off) if last_print.off is not None else ""
        if state == "idle":
            state = "remove" if last_print.state == PrintState.DONE else "to clear"
    return (
        printer.name,
        state,
        part,
        ends,
        deviation,
        f"{printer.time_factor:.2f}",
        _format_reel(printer.reel),
        _format_nozzle(printer),
        _format_degrees(printer.bed_c, printer.targets.bed_c),
        _format_action(printer),
    )


def _format_reel(reel: api.Reel) -> str:
    words = [describe_material(reel.material, reel.kind), reel.colour or ""]
    if reel.grams is not None:
        words.append(f"{reel.grams:.0f}g")
    return " ".join(filter(None, words))


def _format_action(printer: api.PrinterView) -> str:
    """Describe the action that a printer needs before its next print, or name what reserves it."""
    if printer.state == PrintState.PAUSED:
        return "resume"
    if printer.print is not None:
        return ""
    if printer.hold is None:
        return f"kept for {printer.kept_for}" if printer.kept_for else ""
    if printer.state == Link.ABSENT:
        return "connect"
    if printer.maintenance is not None:
        return f"maintenance --done ({printer.maintenance})"
    action_by_code = {
        HoldCode.NEEDS_INSPECTION: "inspect, then clear",
        HoldCode.BED_NOT_CLEAR: "clear",
        HoldCode.FILAMENT_UNKNOWN: "clear with --filament",
        HoldCode.PRINTER_ABSENT: "wait (connecting)",
    }
    return action_by_code.get(printer.hold.code, "")


def _format_nozzle(printer: api.PrinterView) -> str:
    """Format the nozzle's size in mm, and its temperature while the nozzle is heated."""
    heat = _format_degrees(printer.nozzle_c, printer.targets.nozzle_c) if printer.targets.nozzle_c else ""
    return f"{printer.reel.nozzle_mm:g} {heat}".rstrip()


def _format_degrees(now_c: float | None, target_c: float | None) -> str:
    if now_c is None:
        return "-"
    return f"{now_c:.0f}" + (f"/{target_c:.0f}" if target_c else "") + "C"
