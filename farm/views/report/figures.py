"""Figures of a job as named texts, for its report. Pure."""

from __future__ import annotations

from farm import api
from farm.text import format_duration, format_mass
from farm.wording import format_copies, format_runs, format_share, format_time, parse_time


def list_figures(view: api.JobView) -> list[tuple[str, str]]:
    """List the figures of a job, each with its name."""
    actual = "actual" if view.state in ("printed", "done") else "current estimate"
    rows = [
        (
            "submitted",
            f"{parse_time(view.submitted):%a %d %b %Y %H:%M}"
            + (f" by {view.submitted_by}" if view.submitted_by else ""),
        ),
        ("plates printed", f"{view.printed} of {len(view.plates)}; good {view.good}"),
        ("parallel printing time, expected", format_duration(view.expected_s)),
        (f"parallel printing time, {actual}", format_duration(view.current_s)),
        ("single large printer", format_duration(view.serial_s)),
        ("speed-up", f"{view.speedup:.1f}" if view.speedup else "-"),
        ("utilisation", format_share(view.utilisation) if view.utilisation else "-"),
        (
            "wasted",
            f"{format_duration(view.wasted_s)}, {format_mass(view.wasted_grams)}"
            if view.wasted_s
            else "nothing",
        ),
        ("filament", format_mass(view.grams) if view.grams is not None else "-"),
    ]
    if view.options.note:
        rows.insert(1, ("note", view.options.note))
    if view.options.copies > 1:
        rows.insert(1, ("copies printed", format_copies(view)))
    if view.assembly_s is not None:
        expected = "" if view.glued else ", expected"
        rows.append((f"assembly{expected}", format_duration(view.assembly_s)))
        rows.append(
            (f"from submission to assembly{expected}", format_duration(view.submitted_to_assembled_s))
        )
    if len(view.runs) > 1:
        rows.append(
            ("printed in runs", f"{format_runs(view.runs, view.now)}; the time between them is not counted")
        )
    if view.pruned is not None:
        rows.append(("files", f"pruned on {format_time(view.pruned, view.now)}"))
    if view.price is not None:
        rows.append(("price of the filament", f"{view.price:.2f} {view.currency or ''}".strip()))
    return rows
