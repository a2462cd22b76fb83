"""Page of one job on the terminal. `--json` prints all of its content too."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from decompose.files.names import INSTRUCTIONS
from farm import api
from farm.cli.display.console import (
    ERROR_STYLE,
    HEADING_STYLE,
    WARNING_STYLE,
    open_console,
    read_terminal_width,
)
from farm.cli.display.table import Column, lay_out_table
from farm.model import JobState, PrintState, name_plate
from farm.text import format_duration, format_mass
from farm.wording import (
    format_cached_plates,
    format_copies,
    format_deviation,
    format_filament,
    format_planning,
    format_runs,
    format_share,
    format_time,
    group_holds,
    shorten_names,
)

_MAX_STARVED_SHARE = 0.01
"""Share of the time that simulated printers may wait for this computer; print times are invalid above it."""

_PART_COLUMNS = (
    Column("PART"),
    Column("GLUE", rank=4),
    Column("PRINTER"),
    Column("STATE"),
    Column("EXPECTED", rank=2),
    Column("STARTED", rank=3),
    Column("ENDED"),
    Column("FILAMENT", rank=1, min_width=6),
)


def show_job(view: api.JobView) -> None:
    """Print the page of a job."""
    screen = open_console()
    screen.print(render_job(view, read_terminal_width(screen)))


def show_submitted_job(view: api.JobView, wait: bool) -> None:
    """Print the changes that the farm made to a submitted model.

    Unless `wait` is set, also print the command that shows the progress of the job.
    """
    screen = open_console()
    screen.print(f"job {view.id}: {view.name} submitted")
    for line in _list_changes(view):
        screen.print(_format_change(line))
    if not wait:
        if view.hold is not None:
            screen.print(f"  waits: {view.hold.text}")
        screen.print(f"  `farm status {view.id}` shows its progress")


def show_result(view: api.JobView) -> None:
    """Print the page of a job that has ended, and the next step."""
    screen = open_console()
    screen.print(render_job(view, read_terminal_width(screen)))
    if view.state in (JobState.PRINTED, JobState.DONE):
        printers = " ".join(sorted({plate.printer for plate in view.plates}))
        screen.print(f"Next: remove the parts, then `farm cleared {printers}`.")


def render_job(view: api.JobView, width: int | None = None) -> RenderableType:
    """Lay out a job: changes to its model, key figures, parts, failed prints, and reasons to wait.

    Parameters
    ----------
    view
        The job.
    width
        Width of the terminal in columns; None for no limit.
    """
    now = view.now
    rows: list[RenderableType] = [Text(f"Job {view.id}: {view.name}, {view.state}", style=HEADING_STYLE)]
    if view.reason:
        rows.append(Text(f"  {view.reason}", style=ERROR_STYLE))
    rows += [_format_change(line) for line in _list_changes(view)]
    rows += [
        Text(f"  {name_plate(plate.id, plate.parts)}: {line}", style=WARNING_STYLE)
        for plate in view.plates
        for line in plate.warnings
    ]
    figures = Table.grid(padding=(0, 2, 0, 0))
    figures.add_column(no_wrap=True)
    figures.add_column(overflow="fold")
    for name, figure in _list_figures(view):
        figures.add_row(name, figure)
    rows.append(figures)
    if view.parts:
        rows += _lay_out_parts(view, width)
    if view.pruned is not None:
        rows.append(
            Text(f"files: pruned {format_time(view.pruned, now)}; submit the model again to print it")
        )
    elif view.folder:
        rows.append(Text(f"files (STL and G-code of each part, a picture, a GLB): {view.folder}"))
        if view.assembly_s is not None:
            rows.append(Text(f"instructions for gluing: {view.folder}/{INSTRUCTIONS}"))
    for attempt in view.prints:
        if attempt.fault or attempt.why:
            reason = attempt.reason or attempt.why or attempt.fault
            rows.append(
                Text(
                    f"part {attempt.part} on {attempt.printer}, {format_time(attempt.ended, now)}: {reason}",
                    style=ERROR_STYLE,
                )
            )
    rows += _list_holds(view)
    return Group(*rows)


def _list_changes(view: api.JobView) -> list[str]:
    """List the changes that the farm made to the model."""
    scale_notes = [f"Scaled by {view.scale:g}."] if view.scale is not None and view.scale != 1 else []
    return [*view.repairs, *scale_notes]


def _format_change(line: str) -> Text:
    return Text(f"  {line}", style=WARNING_STYLE if line.startswith("Warning: ") else "")


def _list_figures(view: api.JobView) -> list[tuple[str, str]]:
    """List the key figures of a job, each with its name."""
    rows: list[tuple[str, str]] = []
    if view.submitted_by is not None:
        rows.append(("submitted", f"{format_time(view.submitted, view.now)} by {view.submitted_by}"))
    if view.options.note:
        rows.append(("note", view.options.note))
    if view.options.copies > 1:
        rows.append(("copies printed", format_copies(view)))
    if view.progress is not None:
        rows.append(("planning", format_planning(view.progress)))
    if view.plan is not None and view.state == JobState.HELD:
        rows.append(("plan", view.plan))
    if cached_count := sum(plate.cached for plate in view.plates):
        rows.append(("slices", format_cached_plates(cached_count)))
    rows += _list_times(view)
    if view.wasted_s > 0:
        rows.append(("wasted", f"{format_duration(view.wasted_s)}, {format_mass(view.wasted_grams)}"))
    if view.grams is not None and view.filament_mm is not None:
        amount = format_filament(view.grams, view.filament_mm, view.price, view.currency)
        rows.append(("filament", amount))
    if view.starved_share is not None and view.starved_share > _MAX_STARVED_SHARE:
        wait_note = (
            f"simulated printers waited {100 * view.starved_share:.1f} % of the time for this computer"
        )
        rows.append(("times not valid", wait_note))
    return rows


def _list_times(view: api.JobView) -> list[tuple[str, str]]:
    """List the times of a job, its speed-up and the utilisation of its printers."""
    rows: list[tuple[str, str]] = []
    if view.expected_s is not None:
        rows.append(("parallel printing time, expected", format_duration(view.expected_s)))
    if view.elapsed_s is not None:
        is_printed = view.state in (JobState.PRINTED, JobState.DONE)
        label = "parallel printing time, actual" if is_printed else "printed for"
        deviation = ""
        if is_printed and view.expected_s:
            deviation = f"  ({format_deviation(view.elapsed_s / view.expected_s - 1)} vs expected)"
        rows.append(
            (label if view.state.ended else "printing for", format_duration(view.elapsed_s) + deviation)
        )
    if len(view.runs) > 1:
        rows.append(("printed in runs", format_runs(view.runs, view.now)))
    if view.eta and view.state == JobState.PRINTING:
        rows.append(("ends", format_time(view.eta, view.now)))
    if view.assembly_s is not None:
        rows.append(("assembly" if view.glued else "assembly, expected", format_duration(view.assembly_s)))
    if view.assembled is not None and view.submitted_to_assembled_s is not None:
        total_text = f"{format_duration(view.submitted_to_assembled_s)} after submission"
        label = "assembled" if view.glued else "assembled, expected"
        rows.append((label, f"{format_time(view.assembled, view.now)}, {total_text}"))
    if view.serial_s is not None:
        rows.append(("single large printer", format_duration(view.serial_s)))
    if view.speedup is not None:
        rows.append(("speed-up", f"{view.speedup:.1f}"))
    if view.utilisation is not None:
        rows.append(("utilisation", format_share(view.utilisation)))
    return rows


def _lay_out_parts(view: api.JobView, width: int | None) -> list[Text]:
    rows, now = [], view.now
    plates = {plate.id: plate for plate in view.plates}
    for part in view.parts_in_gluing_order:
        plate = plates[part.plate]
        last_print = part.own_prints[-1] if part.own_prints else None
        rows.append(
            (
                part.id,
                str(part.glue_rank or ""),
                plate.printer,
                _format_part_state(part),
                format_duration(plate.expected_s),
                format_time(last_print.started if last_print else None, now),
                format_time(last_print.ended if last_print else None, now),
                format_filament(plate.grams, plate.filament_mm, plate.price, view.currency),
            )
        )
    return lay_out_table(_PART_COLUMNS, rows, width)


def _format_part_state(part: api.PartView) -> str:
    """Format the state of a part's last print, or a person's verdict on the printed part."""
    prints = part.own_prints
    if not prints:
        return "waiting"
    last_print = prints[-1]
    state = (
        str(part.verdict) if part.verdict and last_print.state == PrintState.DONE else str(last_print.state)
    )
    attempt = f", attempt {len(prints)}" if len(prints) > 1 else ""
    return state + attempt


def _list_holds(view: api.JobView) -> list[RenderableType]:
    lines = []
    if view.hold is not None:
        lines.append(Text(f"job {view.id} waits: {view.hold.text}", style=WARNING_STYLE))
    for hold, names in group_holds([view]):
        verb = "waits" if len(names) == 1 else "wait"
        lines.append(Text(f"{shorten_names(names)} {verb}: {hold.text}", style=WARNING_STYLE))
    return list(lines)
