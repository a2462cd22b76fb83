"""Timeline of a planned job as text: a table, and a bar chart with a row for each printer."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from farm import api
from farm.cli.display.console import ERROR_STYLE, open_console, read_terminal_width
from farm.cli.display.table import Column, lay_out_table
from farm.text import format_count, format_duration
from farm.wording import format_time, parse_time

_CHART_WIDTH = 79  # columns
_MIN_BARS_WIDTH = 20  # minimum width of the chart without the names of the printers, in columns
_COLUMNS = (
    Column("PARTS"),
    Column("PRINTER"),
    Column("STARTS"),
    Column("ENDS"),
    Column("DURATION", rank=1),
    Column("GRAMS", rank=2),
    Column("PRICE", rank=3),
)


def show_timeline(view: api.Timeline) -> None:
    """Print the timeline of a job."""
    screen = open_console()
    screen.print(render_timeline(view, read_terminal_width(screen)))


def render_timeline(view: api.Timeline, width: int | None = None) -> RenderableType:
    """Lay out the times, grams and prices of the plates, and the bar chart."""
    now, times = view.now, []
    for slot in view.slots:
        duration_s = (parse_time(slot.ends) - parse_time(slot.starts)).total_seconds()
        times.append(
            (
                " ".join(slot.parts),
                slot.printer,
                format_time(slot.starts, now),
                format_time(slot.ends, now),
                format_duration(duration_s),
                f"{slot.grams:.0f}",
                _format_price(slot.price, view.currency),
            )
        )
    price = f", {_format_price(view.price, view.currency)}" if view.price is not None else ""
    rows: list[RenderableType] = [*map(Text, view.notices), *lay_out_table(_COLUMNS, times, width), Text()]
    rows += [Text(line) for line in draw_gantt(view.slots, now, min(_CHART_WIDTH, width or _CHART_WIDTH))]
    rows.append(Text())
    rows.append(
        Text(
            f"{format_count(len(view.slots), 'plate')}, {format_duration(view.makespan_s)} (lower bound "
            f"{format_duration(view.lower_bound_s)}), {view.grams:.0f} g{price}"
        )
    )
    if view.left:
        rows.append(Text(f"no printer can print {' '.join(view.left)}", style=ERROR_STYLE))
    return Group(*rows)


def draw_gantt(slots: list[api.SlotView], now: str, chart_width: int = _CHART_WIDTH) -> list[str]:
    """Draw a row for each printer with a bar for each plate, and a time axis below.

    Parameters
    ----------
    slots
        The plates.
    now
        Present time; dates are shown only for times that are far from it.
    chart_width
        Width of the chart in columns, including the names of the printers.
    """
    if not slots:
        return []
    begin = min(parse_time(slot.starts) for slot in slots)
    total_s = max((parse_time(slot.ends) - begin).total_seconds() for slot in slots) or 1.0
    name_width = max(len(slot.printer) for slot in slots)
    width = max(_MIN_BARS_WIDTH, chart_width - name_width - 2)
    lines = []
    for printer in sorted({slot.printer for slot in slots}):
        cells = [" "] * width
        for slot in (other for other in slots if other.printer == printer):
            first, last = (
                round((parse_time(time) - begin).total_seconds() / total_s * width)
                for time in (slot.starts, slot.ends)
            )
            first = min(first, width - 1)
            bar = slot.plate.rpartition("/")[2].center(max(1, last - first), "-")
            if last - first > 2:
                bar = f"[{bar[1:-1]}]"
            cells[first : first + len(bar)] = bar[: max(1, last - first)]
        lines.append(f"{printer:<{name_width}}  {''.join(cells).rstrip()}")
    ends = format_time(max(slots, key=lambda slot: parse_time(slot.ends)).ends, now)
    starts = format_time(begin.isoformat(), now)
    lines.append(f"{'':<{name_width}}  {starts}{ends:>{width - len(starts)}}")
    return lines


def _format_price(price: float | None, currency: str | None) -> str:
    return "-" if price is None else f"{price:.2f} {currency or ''}".strip()
