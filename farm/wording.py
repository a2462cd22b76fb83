"""Texts for times, amounts and planning steps in the farm's views. Pure."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime, tzinfo

from farm import api
from farm.model import Hold, PlanProgress, PlanStep, TextTime, name_plate
from farm.text import format_count, format_duration, format_moment


def format_deviation(share: float) -> str:
    """Format a deviation from the planned time in percent, with its sign."""
    return f"{round(100 * share):+d} %"


def format_share(share: float) -> str:
    """Format a share, from 0 to 1, in percent."""
    return f"{100 * share:.0f} %"


def format_filament(
    grams: float, length_mm: float, price: float | None = None, currency: str | None = None
) -> str:
    """Format an amount of filament, with its price if it is known."""
    amounts = [f"{_format_amount(grams)} g", f"{_format_amount(length_mm / 1000)} m"]
    if price is not None:
        amounts.append(f"{price:.2f} {currency}" if currency else f"price {price:.2f}")
    return ", ".join(amounts)


_GENERIC_PREFIX = "generic_"


def describe_material(material: str, kind: str | None) -> str:
    """Describe a material by its kind, like PLA, or by its file's name if the kind is unknown.

    Parameters
    ----------
    material
        Name of its file, like `generic_pla`.
    kind
        Kind of the material; None or empty if it is unknown.
    """
    return kind or (
        material.removeprefix(_GENERIC_PREFIX).upper() if material.startswith(_GENERIC_PREFIX) else material
    )


def format_planning(progress: PlanProgress) -> str:
    """Describe the current step in planning a job."""
    if progress.step is PlanStep.WAITING:
        return "waiting for a worker"
    if progress.step is PlanStep.DECOMPOSING:
        share = "" if progress.share is None else f" {format_share(progress.share)}"
        remaining_s = progress.remaining_s or 0.0
        return f"decomposing{share}" + (
            f", up to about {format_duration(remaining_s)} left" if remaining_s >= 1.0 else ""
        )
    if progress.step is PlanStep.REBALANCING:
        return "balancing the parts by their sliced times"
    if progress.step is PlanStep.NO_ROOM:
        return "waiting for space on the disk"
    return f"slicing {progress.done} of {progress.of}" + (
        f" ({format_cached_plates(progress.cached)})" if progress.cached else ""
    )


def format_copies(view: api.JobView) -> str:
    """Format the number of copies of the model whose parts are all printed."""
    return f"{view.printed_copies} of {view.options.copies}"


def format_cached_plates(plate_count: int) -> str:
    """Format the number of plates that were found in the slice cache."""
    return f"{format_count(plate_count, 'plate')} from the cache"


def _format_amount(amount: float) -> str:
    decimals = 0 if amount >= 100 else 1 if amount >= 1 else 2
    return f"{amount:.{decimals}f}"


def parse_time(iso: str) -> datetime:
    """Parse a time that the daemon has sent, which has a time zone."""
    return datetime.fromisoformat(iso)


def format_time(iso: str | None, now: str) -> str:
    """Format a time with its weekday, or with its date if it is far from now; None gives a dash."""
    return "-" if iso is None else format_moment(parse_time(iso), parse_time(now))


def make_text_time(at_s: float, now_s: float, zone: tzinfo) -> TextTime:
    """Convert a time in seconds since the epoch to text, for a sentence that is shown at `now_s`."""
    at, now = (datetime.fromtimestamp(moment_s, zone) for moment_s in (at_s, now_s))
    return TextTime(text=format_moment(at, now), at=at.isoformat("T", "seconds"))


def format_runs(runs: Sequence[api.RunView], now: str) -> str:
    """Format the time intervals during which a job was printed."""
    return ", ".join(
        f"{format_time(run.started, now)} to {format_time(run.ended, now) if run.ended else 'now'}"
        for run in runs
    )


def shorten_names(printers: Iterable[str]) -> str:
    """Join names, with those that have consecutive numbers as ranges: um2-01..12 um2x-01."""
    runs: list[tuple[str, str, str]] = []  # common stem, first number, last number
    for name in sorted(printers, key=lambda name: (name.rstrip("0123456789"), len(name), name)):
        match = re.fullmatch(r"(.*?)(\d+)", name)
        stem, digits = match.groups() if match else (name, "")
        if digits and runs and runs[-1][0] == stem and int(digits) == int(runs[-1][2] or -2) + 1:
            runs[-1] = (stem, runs[-1][1], digits)
        else:
            runs.append((stem, digits, digits))
    return " ".join(stem + first + (f"..{last}" if last != first else "") for stem, first, last in runs)


def join_counted_names(names: Iterable[str]) -> str:
    """Join names; state how often a repeated name occurs: a.stl, b.stl (3)."""
    counts = Counter(names)
    return ", ".join(name + (f" ({count})" if count > 1 else "") for name, count in counts.items())


def group_holds(jobs: Iterable[api.JobView]) -> list[tuple[Hold, list[str]]]:
    """Group the names of waiting plates by the text of their hold, in the order of the first plates."""
    groups: dict[str, tuple[Hold, list[str]]] = {}
    for job in jobs:
        for plate in job.plates:
            if plate.hold is not None:
                _, names = groups.setdefault(plate.hold.text, (plate.hold, []))
                names.append(name_plate(plate.id, plate.parts))
    return list(groups.values())
