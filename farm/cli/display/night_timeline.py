"""The night of a job as text: a table, and a line of time for each printer."""

from __future__ import annotations

from datetime import datetime

from rich.console import Group, RenderableType
from rich.text import Text

from farm import api
from farm.cli.display.console import console, table
from farm.cli.display.format import moment
from farm.text import count, span

_WIDTH = 64  # characters of the line of time


def show(view: api.Night) -> None:
    console().print(night(view))


def night(view: api.Night) -> RenderableType:
    """Parts, printers, times, grams and price; then who prints when."""
    times = table("PARTS", "PRINTER", "STARTS", "ENDS", "TAKES", "GRAMS", "PRICE")
    for slot in view.slots:
        takes_s = (_at(slot.ends) - _at(slot.starts)).total_seconds()
        times.add_row(
            " ".join(slot.parts),
            slot.printer,
            moment(slot.starts),
            moment(slot.ends),
            span(takes_s),
            f"{slot.grams:.0f}",
            _money(slot.price, view.currency),
        )
    price = f", {_money(view.price, view.currency)}" if view.price is not None else ""
    rows: list[RenderableType] = [*map(Text, view.notices), times, Text()]
    rows += [Text(line) for line in gantt(view.slots)]
    rows.append(Text())
    rows.append(
        Text(
            f"{count(len(view.slots), 'plate')}, {span(view.makespan_s)} (no order of them takes less than "
            f"{span(view.lower_bound_s)}), {view.grams:.0f} g{price}"
        )
    )
    if view.left:
        rows.append(Text(f"no printer can take: {' '.join(view.left)}", style="red"))
    return Group(*rows)


def gantt(slots: list[api.SlotView], width: int = _WIDTH) -> list[str]:
    """A line for each printer: a bar for each plate with its number in it, and a scale of time below."""
    if not slots:
        return []
    begin = min(_at(slot.starts) for slot in slots)
    whole_s = max((_at(slot.ends) - begin).total_seconds() for slot in slots) or 1.0
    name_width = max(len(slot.printer) for slot in slots)
    lines = []
    for printer in sorted({slot.printer for slot in slots}):
        cells = [" "] * width
        for slot in (one for one in slots if one.printer == printer):
            first, last = (
                round((_at(moment) - begin).total_seconds() / whole_s * width)
                for moment in (slot.starts, slot.ends)
            )
            first = min(first, width - 1)
            bar = slot.plate.rpartition("/")[2].center(max(1, last - first), "-")
            if last - first > 2:
                bar = f"[{bar[1:-1]}]"
            cells[first : first + len(bar)] = bar[: max(1, last - first)]
        lines.append(f"{printer:<{name_width}}  {''.join(cells).rstrip()}")
    ends = moment(max(slots, key=lambda slot: _at(slot.ends)).ends)
    starts = moment(begin.isoformat())
    lines.append(f"{'':<{name_width}}  {starts}{ends:>{width - len(starts)}}")
    return lines


def _at(iso: str) -> datetime:
    return datetime.fromisoformat(iso)


def _money(price: float | None, currency: str | None) -> str:
    return "-" if price is None else f"{price:.2f} {currency or ''}".strip()
