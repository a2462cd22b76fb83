"""Finished prints from which the time factors of a printer are learned. Pure."""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from itertools import islice

from farm.model import FeatureFactors, Plate, Print, Printer, PrintState
from farm.state.books import Books, replace_fields
from farm.state.printer_speed.feature_factors import MAX_PRINTS, MIN_PRINTS, Timing, fit_feature_factors
from farm.state.printer_speed.time_factor import is_learnable, update_time_factor

_MAX_CANDIDATES = 4 * MAX_PRINTS
"""Number of latest prints that are searched for usable timings."""


def learn_speed(books: Books, printer: Printer, attempt: Print) -> Printer:
    """Return a printer with its time factors updated by a print that is done.

    Parameters
    ----------
    books
        Books that contain the ended print.
    printer
        The printer, with the other changes from the event that ended the print already applied.
    attempt
        The print.
    """
    plate, actual_s = books.plates[attempt.plate], _compute_actual_s(books, attempt)
    if actual_s is None:
        return printer
    factor = update_time_factor(printer.time_factor, plate.sliced_s, actual_s, attempt.starved_s)
    printer = replace_fields(printer, time_factor=factor)
    if _make_timing(books, attempt) is None:
        return printer
    timings, is_own = list_timings(books, printer), True
    if len(timings) < MIN_PRINTS:
        timings, is_own = list_family_timings(books, printer, plate), False
    factors = fit_feature_factors(timings)
    if factors is None:
        return printer
    factor_by_feature = dict(zip(("walls", "infill", "skins", "supports", "travel"), factors, strict=True))
    learned_factors = FeatureFactors(**factor_by_feature, prints=len(timings), own=is_own)
    return replace_fields(printer, feature_factors=learned_factors)


def list_timings(books: Books, printer: Printer) -> list[Timing]:
    """List the latest usable timings of a printer's prints, at most MAX_PRINTS, newest first."""
    prints = (p for p in books.prints.values() if p.printer == printer.name)
    return [timing for _, timing in _list_latest_timings(books, prints)]


def list_family_timings(books: Books, printer: Printer, plate: Plate) -> list[Timing]:
    """List the latest usable timings of plates sliced for the same printer family as `plate`.

    The ratios are scaled to the time factor of `printer`.
    """
    prints = (p for p in books.prints.values() if books.plates[p.plate].family == plate.family)
    return [
        Timing(timing.shares, timing.ratio * printer.time_factor / books.get_printer(name).time_factor)
        for name, timing in _list_latest_timings(books, prints)
    ]


def _list_latest_timings(books: Books, prints: Iterable[Print]) -> list[tuple[str, Timing]]:
    """List the printers and timings of the latest prints with a usable timing, newest first."""
    done_prints = (p for p in prints if p.state is PrintState.DONE and not p.paused)
    candidates = heapq.nlargest(_MAX_CANDIDATES, done_prints, key=lambda p: (p.ended_s or 0.0, p.id))
    timings = ((attempt.printer, _make_timing(books, attempt)) for attempt in candidates)
    return list(islice(((name, timing) for name, timing in timings if timing is not None), MAX_PRINTS))


def _make_timing(books: Books, attempt: Print) -> Timing | None:
    """Make the timing of a finished print; None if factors by feature cannot be learned from it."""
    plate, actual_s = books.plates[attempt.plate], _compute_actual_s(books, attempt)
    shares = plate.feature_shares
    if shares is None or actual_s is None:
        return None
    if not is_learnable(plate.sliced_s, actual_s, attempt.starved_s):
        return None
    return Timing(shares, actual_s / plate.sliced_s)


def _compute_actual_s(books: Books, attempt: Print) -> float | None:
    """Compute the seconds that the layers of an ended print took; None if it never started."""
    if attempt.started_s is None or attempt.ended_s is None:
        return None
    return attempt.ended_s - attempt.started_s - books.plates[attempt.plate].overhead_s
