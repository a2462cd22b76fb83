"""Figures of ended prints, in total and by printer, material and month: success, time, filament. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, tzinfo

from farm.model import Plate, Print, PrintState, Verdict
from farm.views.accounting import compute_duration_s, is_wasted


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of some prints that have ended.

    Attributes
    ----------
    name
        Name of what the prints have in common: a printer, a material or a month.
    print_count
        Number of prints that were started, including cancelled ones.
    good_count
        Number of prints that are done, except those that a person judged bad.
    failed_count
        Number of prints that failed or were judged bad.
    used_s, wasted_s
        Printing time of all prints, and of the wasted ones: failed, cancelled or judged bad.
    grams, wasted_grams
        Filament that all prints used, and that the wasted prints used.
    expected_s, actual_s
        Expected and actual printing time of the prints that are done and were never paused. Their ratio shows
        the accuracy of forecasts.
    """

    name: str
    print_count: int = 0
    good_count: int = 0
    failed_count: int = 0
    cancelled_count: int = 0
    used_s: float = 0.0
    wasted_s: float = 0.0
    grams: float = 0.0
    wasted_grams: float = 0.0
    expected_s: float = 0.0
    actual_s: float = 0.0

    @property
    def success_share(self) -> float | None:
        """Share of good prints among good and failed prints; None if there are no such prints."""
        decided_count = self.good_count + self.failed_count
        return self.good_count / decided_count if decided_count else None

    @property
    def deviation(self) -> float | None:
        """Ratio of the actual to the expected time, minus 1; None if there are no prints to compare."""
        return self.actual_s / self.expected_s - 1 if self.expected_s else None


def sum_figures(name: str, prints: Iterable[Print], plates: Mapping[str, Plate]) -> Figures:
    """Add up the figures of those prints that were started and have ended.

    Parameters
    ----------
    name
        Name of what the prints have in common.
    prints
        Prints, which may include open ones.
    plates
        Plates of the prints, by id.
    """
    ended_prints = [attempt for attempt in prints if attempt.state.ended and attempt.started_s is not None]
    wasted_prints = [attempt for attempt in ended_prints if is_wasted(attempt)]
    compared_prints = [
        attempt for attempt in ended_prints if attempt.state is PrintState.DONE and not attempt.paused
    ]
    bad_count = sum(
        attempt.state is PrintState.DONE and attempt.verdict is Verdict.BAD for attempt in ended_prints
    )
    return Figures(
        name=name,
        print_count=len(ended_prints),
        good_count=len(ended_prints) - len(wasted_prints),
        failed_count=bad_count + sum(attempt.state is PrintState.FAILED for attempt in ended_prints),
        cancelled_count=sum(attempt.state is PrintState.CANCELLED for attempt in ended_prints),
        used_s=sum(map(compute_duration_s, ended_prints)),
        wasted_s=sum(map(compute_duration_s, wasted_prints)),
        grams=sum(attempt.grams for attempt in ended_prints),
        wasted_grams=sum(attempt.grams for attempt in wasted_prints),
        expected_s=sum(plates[attempt.plate].expected_s for attempt in compared_prints),
        actual_s=sum(map(compute_duration_s, compared_prints)),
    )


def group_figures(
    prints: Iterable[Print], plates: Mapping[str, Plate], name_group: Callable[[Print], str]
) -> list[Figures]:
    """Add up the figures of ended prints by group; `name_group` returns the name of a print's group."""
    groups: dict[str, list[Print]] = {}
    for attempt in prints:
        groups.setdefault(name_group(attempt), []).append(attempt)
    figures = (sum_figures(group, groups[group], plates) for group in sorted(groups))
    return [group for group in figures if group.print_count]


def name_month(attempt: Print, zone: tzinfo) -> str:
    """Return the month in which a print ended, such as 2026-11; return an empty string for an open print."""
    return "" if attempt.ended_s is None else f"{datetime.fromtimestamp(attempt.ended_s, zone):%Y-%m}"
