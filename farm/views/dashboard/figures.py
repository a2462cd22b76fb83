"""Figures of ended prints, in total and by printer, material and month: success, time, plastic. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, tzinfo

from farm.model import Plate, Print, PrintState, Verdict
from farm.views.accounting import duration_s, is_wasted


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of some prints that have ended.

    Attributes
    ----------
    name
        Common property: a printer, a material, a month.
    prints
        Number of prints that were started, `cancelled` ones among them.
    good
        Done, and not found bad by a person.
    failed
        Failed, or found bad.
    used_s, wasted_s
        Time on printers: of all prints, and of those that failed, were cancelled or are bad.
    grams, wasted_grams
        Filament of all of them, and of the wasted ones.
    expected_s, reached_s
        Of those that were done without a pause: expected and actual time. Their ratio tells how far to
        trust a forecast.
    """

    name: str
    prints: int = 0
    good: int = 0
    failed: int = 0
    cancelled: int = 0
    used_s: float = 0.0
    wasted_s: float = 0.0
    grams: float = 0.0
    wasted_grams: float = 0.0
    expected_s: float = 0.0
    reached_s: float = 0.0

    @property
    def success(self) -> float | None:
        """Return the share of good prints among good and failed ones; None if there are none."""
        return self.good / (self.good + self.failed) if self.good + self.failed else None

    @property
    def deviation(self) -> float | None:
        """Return the share by which prints took longer than expected; None if none was done."""
        return self.reached_s / self.expected_s - 1 if self.expected_s else None


def sum_figures(name: str, prints: Iterable[Print], plates: Mapping[str, Plate]) -> Figures:
    """Add up prints that have ended; those that were never started do not count.

    Parameters
    ----------
    name
        Common property of the prints.
    prints
        Prints, open ones too, which do not count either.
    plates
        Their plates, by name.
    """
    ended = [one for one in prints if one.state.ended and one.started_s is not None]
    wasted = [one for one in ended if is_wasted(one)]
    compared = [one for one in ended if one.state is PrintState.DONE and not one.paused]
    bad = sum(one.state is PrintState.DONE and one.verdict is Verdict.BAD for one in ended)
    return Figures(
        name=name,
        prints=len(ended),
        good=len(ended) - len(wasted),
        failed=bad + sum(one.state is PrintState.FAILED for one in ended),
        cancelled=sum(one.state is PrintState.CANCELLED for one in ended),
        used_s=sum(map(duration_s, ended)),
        wasted_s=sum(map(duration_s, wasted)),
        grams=sum(one.grams for one in ended),
        wasted_grams=sum(one.grams for one in wasted),
        expected_s=sum(plates[one.plate].expected_s for one in compared),
        reached_s=sum(map(duration_s, compared)),
    )


def group_figures(
    prints: Iterable[Print], plates: Mapping[str, Plate], name: Callable[[Print], str]
) -> list[Figures]:
    """Add up ended prints in groups, by the names of the groups."""
    groups: dict[str, list[Print]] = {}
    for one in prints:
        groups.setdefault(name(one), []).append(one)
    figures = (sum_figures(group, groups[group], plates) for group in sorted(groups))
    return [one for one in figures if one.prints]


def name_month(one: Print, zone: tzinfo) -> str:
    """Name the month in which a print ended, like 2026-11; empty if it has not."""
    return "" if one.ended_s is None else f"{datetime.fromtimestamp(one.ended_s, zone):%Y-%m}"
