"""Views of printers. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from drivers.messages import PrintReadings
from farm import api
from farm.config import PrinterSection
from farm.model import AgentSnapshot, Hold, Link, Print, Printer, PrintState
from farm.views.accounting import compute_duration_s
from farm.views.context import ViewContext


def describe_printer(
    context: ViewContext, section: PrinterSection, hold: Hold | None, kept_for: str | None = None
) -> api.PrinterView:
    """Describe a printer.

    Parameters
    ----------
    context
        Current data of the farm.
    section
        Section of the printer in `fleet.yaml`.
    hold
        Reason for which the printer gets no plate now.
    kept_for
        Plate or job for which the free printer is reserved.
    """
    entry = context.books.get_printer(section.name)
    snapshot = context.find_snapshot(section.name)
    attempt = context.books.find_open_print(section.name)
    return api.PrinterView(
        **snapshot.dump_readings(),
        name=section.name,
        model=section.model,
        state=_derive_printer_state(entry, snapshot, attempt, section.enabled),
        bed=entry.bed,
        filament=entry.filament,
        reel=_describe_reel(section, entry),
        agent_pid=snapshot.agent_pid,
        nozzle_c=snapshot.nozzle_c,
        bed_c=snapshot.bed_c,
        targets=api.Targets(nozzle_c=snapshot.nozzle_target_c, bed_c=snapshot.bed_target_c),
        time_factor=entry.time_factor,
        feature_factors=describe_feature_factors(entry),
        print=_describe_progress(context, attempt) if attempt else None,
        last=_describe_last_print(context, section.name),
        look=entry.attention_reason
        or (snapshot.reason if snapshot.host_lost or snapshot.link in (Link.FAULT, Link.ABSENT) else None),
        maintenance=entry.maintenance,
        hold=hold,
        kept_for=kept_for,
        camera=section.camera is not None,
    )


def describe_feature_factors(entry: Printer) -> api.FeatureFactorsView | None:
    """Describe a printer's time factors by feature; return None until they are learned from enough prints."""
    factors = entry.feature_factors
    return None if factors is None else api.FeatureFactorsView(**dict(factors))


def list_speeds(context: ViewContext, rows: Iterable[api.HistoryRow]) -> list[api.PrinterSpeed]:
    """List the time factors of the printers of some prints, sorted by name."""
    printers = context.books.printers
    names = sorted({row.printer for row in rows} & printers.keys())
    return [
        api.PrinterSpeed(
            printer=entry.name,
            time_factor=entry.time_factor,
            feature_factors=describe_feature_factors(entry),
        )
        for entry in map(printers.__getitem__, names)
    ]


def _describe_last_print(context: ViewContext, printer: str) -> api.LastPrint | None:
    attempt = context.books.find_last_print(printer)
    if attempt is None:
        return None
    deviation, plate = None, context.books.plates[attempt.plate]
    if attempt.state is PrintState.DONE and not attempt.paused:
        deviation = compute_duration_s(attempt) / plate.expected_s - 1
    return api.LastPrint(
        id=attempt.id,
        plate=attempt.plate,
        parts=list(plate.parts),
        state=attempt.state,
        ended=context.format_time(attempt.ended_s),
        off=deviation,
        verdict=attempt.verdict,
    )


def _describe_reel(section: PrinterSection, entry: Printer) -> api.Reel:
    return api.Reel(
        material=section.material,
        kind=section.material_kind,
        colour=section.colour,
        grams=entry.reel.grams if entry.reel is not None else None,
        nozzle_mm=section.nozzle_mm,
    )


def _describe_progress(context: ViewContext, attempt: Print) -> api.PrintProgress:
    plate = context.books.plates[attempt.plate]
    remaining_s = context.estimate_remaining_s(attempt)
    report = context.find_reported_print(attempt)
    return api.PrintProgress(
        **(report or PrintReadings()).dump_readings(),
        job=attempt.job,
        plate=attempt.plate,
        parts=list(plate.parts),
        state=attempt.shown_state,
        progress=min(1.0, max(0.0, 1 - remaining_s / plate.expected_s)),
        remaining_s=remaining_s,
        layers=plate.layers,
        pause_ends=context.format_time(report.pause_ends_s if report else None),
    )


def _derive_printer_state(
    entry: Printer, snapshot: AgentSnapshot, attempt: Print | None, is_enabled: bool
) -> str:
    """Derive the state for `--json`; `look` means that a person must inspect the printer."""
    if not is_enabled:
        return "disabled"
    if snapshot.alarm is not None:
        return "look"
    if snapshot.host_lost:
        return "unknown"
    if attempt is not None:
        return str(attempt.shown_state)
    if entry.maintenance is not None:
        return "maintenance"
    if entry.attention_reason is not None and snapshot.link is not Link.ABSENT:
        return "look"
    return "idle" if snapshot.link is Link.READY else str(snapshot.link)
