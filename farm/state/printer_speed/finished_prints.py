"""Finished prints from which the speed of a printer is learned."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

from farm.model import FeatureFactors, Plate, Print, Printer, PrintState, Shares
from farm.state.books import Books, replace_fields
from farm.state.printer_speed.feature_factors import MAX_PRINTS, MIN_PRINTS, Timing, fit_feature_factors
from farm.state.printer_speed.time_factor import shows_speed, update_time_factor


def learn_speed(books: Books, printer: Printer, attempt: Print) -> Printer:
    """Return a printer with the factors that follow from a print that has ended.

    Parameters
    ----------
    books
        Books with the print.
    printer
        Its printer, as far as the event has changed it.
    attempt
        The print.
    """
    plate, reached_s = books.plates[attempt.plate], _compute_reached_s(books, attempt)
    if reached_s is None:
        return printer
    factor = update_time_factor(printer.time_factor, plate.sliced_s, reached_s, attempt.starved_s)
    printer = replace_fields(printer, time_factor=factor)
    if plate.features is None or not shows_speed(plate.sliced_s, reached_s, attempt.starved_s):
        return printer
    timings, own = list_timings(books, printer), True
    if len(timings) < MIN_PRINTS:
        timings, own = list_family_timings(books, printer, plate), False
    factors = fit_feature_factors(timings)
    if factors is None:
        return printer
    by_feature = dict(zip(("walls", "infill", "skins", "supports", "travel"), factors, strict=True))
    learned_factors = FeatureFactors(**by_feature, prints=len(timings), own=own)
    return replace_fields(printer, feature_factors=learned_factors)


def list_timings(books: Books, printer: Printer) -> list[Timing]:
    """List the latest prints of a printer that show its speed, at most MAX_PRINTS, the newest first."""
    prints = (p for p in books.prints.values() if p.printer == printer.name)
    newest = heapq.nlargest(MAX_PRINTS, _list_usable(books, prints))
    return [Timing(shares, ratio) for _, _, shares, ratio in newest]


def list_family_timings(books: Books, printer: Printer, plate: Plate) -> list[Timing]:
    """List the latest prints of all printers of a plate's family, as if this printer had printed them."""
    prints = (p for p in books.prints.values() if books.plates[p.plate].family == plate.family)
    newest = heapq.nlargest(MAX_PRINTS, _list_usable(books, prints))
    return [
        Timing(shares, ratio * printer.time_factor / books.printer(books.prints[name].printer).time_factor)
        for _, name, shares, ratio in newest
    ]


def _list_usable(books: Books, prints: Iterable[Print]) -> Iterator[tuple[float, str, Shares, float]]:
    """Yield the end, the id, the shares and the ratio of each print that shows the speed by feature."""
    for attempt in prints:
        if attempt.state is not PrintState.DONE or attempt.ended_s is None or attempt.paused:
            continue
        plate, reached_s = books.plates[attempt.plate], _compute_reached_s(books, attempt)
        if reached_s is None or not shows_speed(plate.sliced_s, reached_s, attempt.starved_s):
            continue
        shares = plate.feature_shares
        if shares is not None:
            yield attempt.ended_s, attempt.id, shares, reached_s / plate.sliced_s


def _compute_reached_s(books: Books, attempt: Print) -> float | None:
    """Compute the seconds that the layers of an ended print took; None if it never started."""
    if attempt.started_s is None or attempt.ended_s is None:
        return None
    return attempt.ended_s - attempt.started_s - books.plates[attempt.plate].prelude_s
