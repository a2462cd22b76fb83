"""Chart of the time curve, expected printing time over number of printers; users choose the number. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from farm.model import TextTime
from farm.text import format_count, format_duration
from farm.views.report.decomposition import CurvePoint
from farm.wording import make_text_time

_WIDTH, _HEIGHT, _LEFT_MARGIN, _RIGHT_MARGIN, _TOP_MARGIN, _BOTTOM_MARGIN = 640, 220, 60, 16, 12, 28  # px
_MAX_LABELS = 12


@dataclass(frozen=True, slots=True)
class Choice:
    """Point of the time curve, which a user can choose.

    Attributes
    ----------
    printer_count
        Number of printers.
    text
        Text with the number, the printing time and the time of the end.
    x, y
        Position in the chart, px.
    label
        Number of printers, as a label below the axis; empty if there is no space for it.
    is_chosen
        True if the current plan has this number of printers.
    end
        Time at which printing is expected to end.
    """

    printer_count: int
    text: str
    x: float
    y: float
    label: str
    is_chosen: bool
    end: TextTime


@dataclass(frozen=True, slots=True)
class TimeCurve:
    """Layout of the chart; lengths in px."""

    choices: tuple[Choice, ...]
    polyline: str  # vertices, as SVG writes them
    longest_time: str
    width: int = _WIDTH
    height: int = _HEIGHT
    left: int = _LEFT_MARGIN
    top: int = _TOP_MARGIN
    bottom: int = _HEIGHT - _BOTTOM_MARGIN
    right: int = _WIDTH - _RIGHT_MARGIN


def lay_out_time_curve(
    points: Sequence[CurvePoint], chosen_count: int, start: datetime, now: datetime
) -> TimeCurve | None:
    """Lay out a time curve; return None if there are fewer than two points.

    Parameters
    ----------
    points
        Points of the time curve.
    chosen_count
        Number of printers in the plan.
    start
        Time at which printing would start.
    now
        Current time on the farm's clock.
    """
    times_s = {point.printers: point.makespan_s for point in points if point.makespan_s > 0}
    if len(times_s) < 2:
        return None
    printer_counts = sorted(times_s)
    least, most, longest_s = printer_counts[0], printer_counts[-1], max(times_s.values())
    label_interval = -(-(most - least + 1) // _MAX_LABELS)

    def place_choice(printer_count: int) -> Choice:
        time_s = times_s[printer_count]
        end = make_text_time(start.timestamp() + time_s, now.timestamp(), now.tzinfo or UTC)
        printers_text = format_count(printer_count, "printer")
        return Choice(
            printer_count=printer_count,
            text=f"{printers_text}: about {format_duration(time_s)}, ends {end.text}",
            x=_LEFT_MARGIN
            + (_WIDTH - _LEFT_MARGIN - _RIGHT_MARGIN) * (printer_count - least) / (most - least),
            y=_TOP_MARGIN + (_HEIGHT - _TOP_MARGIN - _BOTTOM_MARGIN) * (1 - time_s / longest_s),
            label=str(printer_count) if (printer_count - least) % label_interval == 0 else "",
            is_chosen=printer_count == chosen_count,
            end=end,
        )

    choices = tuple(place_choice(printer_count) for printer_count in printer_counts)
    polyline = " ".join(f"{choice.x:.1f},{choice.y:.1f}" for choice in choices)
    return TimeCurve(choices, polyline, format_duration(longest_s))
