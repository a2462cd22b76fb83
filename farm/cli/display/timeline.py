"""The timeline of a planned job as text: a table, and a bar chart with a row for each printer."""

from __future__ import annotations

from datetime import datetime

from rich.console import Group, RenderableType
from rich.text import Text

from farm import api
from farm.cli.display.console import ERROR, make_table, open_console
from farm.cli.display.format import format_time
from farm.text import format_count, format_duration

_WIDTH = 64  # characters of a row of the chart


def show_timeline(view: api.Timeline) -> None:
    """Print the timeline of a job."""
    open_console().print(render_timeline(view))


def render_timeline(view: api.Timeline) -> RenderableType:
    """Lay out the times, grams and prices of the plates, and the bar chart."""
    times = make_table("PARTS", "PRINTER", "STARTS", "ENDS", "DURATION", "GRAMS", "PRICE")
    for slot in view.slots:
        duration_s = (_parse_time(slot.ends) - _parse_time(slot.starts)).total_seconds()
        times.add_row(
            " ".join(slot.parts),
            slot.printer,
            format_time(slot.starts),
            format_time(slot.ends),
            format_duration(duration_s),
            f"{slot.grams:.0f}",
            _format_price(slot.price, view.currency),
        )
    price = f", {_format_price(view.price, view.currency)}" if view.price is not None else ""
    rows: list[RenderableType] = [*map(Text, view.notices), times, Text()]
    rows += [Text(line) for line in draw_gantt(view.slots)]
    rows.append(Text())
    rows.append(
        Text(
            f"{format_count(len(view.slots), 'plate')}, {format_duration(view.makespan_s)} (lower bound "
            f"{format_duration(view.lower_bound_s)}), {view.grams:.0f} g{price}"
        )
    )
    if view.left:
        rows.append(Text(f"no printer can print: {' '.join(view.left)}", style=ERROR))
    return Group(*rows)


def draw_gantt(slots: list[api.SlotView], width: int = _WIDTH) -> list[str]:
    """Draw a row for each printer with a bar for each plate, and a time axis below."""
    if not slots:
        return []
    begin = min(_parse_time(slot.starts) for slot in slots)
    whole_s = max((_parse_time(slot.ends) - begin).total_seconds() for slot in slots) or 1.0
    name_width = max(len(slot.printer) for slot in slots)
    lines = []
    for printer in sorted({slot.printer for slot in slots}):
        cells = [" "] * width
        for slot in (one for one in slots if one.printer == printer):
            first, last = (
                round((_parse_time(iso) - begin).total_seconds() / whole_s * width)
                for iso in (slot.starts, slot.ends)
            )
            first = min(first, width - 1)
            bar = slot.plate.rpartition("/")[2].center(max(1, last - first), "-")
            if last - first > 2:
                bar = f"[{bar[1:-1]}]"
            cells[first : first + len(bar)] = bar[: max(1, last - first)]
        lines.append(f"{printer:<{name_width}}  {''.join(cells).rstrip()}")
    ends = format_time(max(slots, key=lambda slot: _parse_time(slot.ends)).ends)
    starts = format_time(begin.isoformat())
    lines.append(f"{'':<{name_width}}  {starts}{ends:>{width - len(starts)}}")
    return lines


def _parse_time(iso: str) -> datetime:
    return datetime.fromisoformat(iso)


def _format_price(price: float | None, currency: str | None) -> str:
    return "-" if price is None else f"{price:.2f} {currency or ''}".strip()
