"""Whether a part is better made otherwise than it was planned. Pure.

What waits for printers of one kind may be sliced for a printer of another kind that is free. What failed may
be cut for several free printers. Either is done only where the part is there sooner, by a margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from farm.model import Bed, HoldCode
from farm.scheduling.assign import assign
from farm.scheduling.forecast import forecast, seconds_on
from farm.scheduling.situation import PlateView, PrinterView
from farm.scheduling.start_rules import Rules, short_of_filament

MARGIN = 0.2
"""Of the time until the part would be there: what making it otherwise must save at least."""
LEAST_GAIN_S = 1800.0
"""And this: a new plan is trouble of its own."""
JOIN_S = 336.0
"""A piece more: a person takes it off its bed (2 min) and glues it (3.6 min), as `decompose.curve` has it."""
SLICING_S, CUTTING_S = 120.0, 300.0
"""Wall seconds that a slice, or a cut and its slices, take as a rule."""
MOST_PIECES = 8
_MORE = 1.15  # pieces take longer together than the whole: walls and tops at every cut
_WAITS = (
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.NEEDS_A_LOOK,
    HoldCode.PRINTER_ABSENT,
    HoldCode.MAINTENANCE,
    HoldCode.REEL_TOO_SHORT,
    HoldCode.REEL_DOUBTED,
    HoldCode.UNATTENDED,
    HoldCode.NO_SUCH_PRINTER,
)
"""What a printer of another kind may be free of."""


@dataclass(frozen=True, slots=True)
class Slice:
    """Slice a waiting plate's part for this printer."""

    plate: str
    printer: str


@dataclass(frozen=True, slots=True)
class Cut:
    """Cut a failed plate's part for these printers."""

    plate: str
    printers: tuple[str, ...]


def sooner(before_s: float, otherwise_s: float, now_s: float) -> bool:
    """Whether a part that is there at `otherwise_s` is there sooner than at `before_s`, by the margin."""
    return otherwise_s + max(LEAST_GAIN_S, MARGIN * (before_s - now_s)) <= before_s


def ends_s(
    plate: PlateView,
    waiting: Sequence[PlateView],
    printers: Sequence[PrinterView],
    rules: Rules,
    now_s: float,
) -> float:
    """When a waiting plate should end, beside all the others; infinite where nobody knows.

    Printers that have to be looked at are counted on only where it is known when somebody comes.
    """
    if rules.attended.windows:
        printers = [replace(p, look=None, bed=Bed.NOT_CLEAR) if p.look is not None else p for p in printers]
    seen = forecast(waiting, printers, rules, now_s)
    return next((slot.ends_s for slot in seen.slots if slot.plate == plate.id), float("inf"))


def whole_s(
    plate: PlateView,
    waiting: Sequence[PlateView],
    printers: Sequence[PrinterView],
    rules: Rules,
    now_s: float,
    scale: float = 1.0,
) -> float:
    """When a waiting plate's part should be there in one piece, sliced again where that is sooner."""
    other = _best_other(plate, [p for p in printers if p.obstacle() is None], rules, now_s)
    ends = ends_s(plate, waiting, printers, rules, now_s)
    if other is None:
        return ends
    return min(ends, now_s + SLICING_S * scale + _seconds_sliced_for(plate, other))


def to_slice(
    plate: PlateView,
    waiting: Sequence[PlateView],
    printers: Sequence[PrinterView],
    free: Sequence[PrinterView],
    rules: Rules,
    now_s: float,
    scale: float = 1.0,
) -> Slice | None:
    """The printer of another kind on which a waiting plate would end sooner by the margin, if there is one.

    Parameters
    ----------
    plate, waiting
        A plate that no printer takes now, and all that wait, this one among them.
    printers, free
        The fleet, and those of it that nothing else will take now.
    scale
        Farm seconds in a wall second, in which it is sliced.
    """
    best = _best_other(plate, free, rules, now_s)
    if best is None:
        return None
    there_s = now_s + SLICING_S * scale + _seconds_sliced_for(plate, best)
    if not sooner(ends_s(plate, waiting, printers, rules, now_s), there_s, now_s):
        return None
    return Slice(plate.id, best.name)


def to_cut(
    plate: PlateView,
    waiting: Sequence[PlateView],
    printers: Sequence[PrinterView],
    rules: Rules,
    now_s: float,
    scale: float = 1.0,
) -> Cut | None:
    """The printers over which a failed plate's part would be there sooner by the margin, if there are some.

    They are those that the other waiting plates leave. The pieces are taken to be equal here; what the cut
    really gives is compared again before anything is booked.

    Parameters
    ----------
    plate, waiting
        A plate that failed, and all that wait, this one among them.
    printers
        The fleet.
    scale
        Farm seconds in a wall second, in which its pieces are cut and sliced.
    """
    others = [other for other in waiting if other.id != plate.id]
    taken = {given.printer for given in assign(others, printers, rules, now_s)[0]}
    layers_s = plate.estimated_s - plate.heating_s
    piece = replace(plate, estimated_s=plate.heating_s + layers_s * _MORE / 2, grams=0.0)
    free = [
        p
        for p in printers
        if p.obstacle() is None
        and p.name not in taken
        and _same_filament(plate, p)
        and _could_start(piece, p, rules, now_s)
    ]
    most = min(len(free), MOST_PIECES, len(free) if plate.places is None else plate.places)
    if most < 2:
        return None
    free.sort(key=lambda p: (p.name in plate.failed_on, p.time_factor, -p.kind.height_mm, p.name))

    def there_s(count: int) -> float:
        slowest = max(p.time_factor for p in free[:count]) / plate.time_factor
        begins_s = now_s + CUTTING_S * scale
        return begins_s + plate.heating_s + layers_s * _MORE * slowest / count + JOIN_S * count

    count = min(range(2, most + 1), key=there_s)
    if not sooner(whole_s(plate, waiting, printers, rules, now_s, scale), there_s(count), now_s):
        return None
    return Cut(plate.id, tuple(p.name for p in free[:count]))


def waits_for_a_kind(code: HoldCode) -> bool:
    """Whether what a plate waits for is its own kind of printer."""
    return code in _WAITS


def _same_filament(plate: PlateView, printer: PrinterView) -> bool:
    need, kind = plate.need, printer.kind
    return need.material in (None, kind.material) and need.colour in (None, kind.colour)


def _other_kind(plate: PlateView, printer: PrinterView) -> bool:
    """Whether only the kind of printer that it was sliced for keeps it from this one."""
    need = replace(plate.need, kin=None, nozzle_mm=None)
    return need.matches(printer.kind) and not plate.need.matches(printer.kind)


def _best_other(
    plate: PlateView, free: Sequence[PrinterView], rules: Rules, now_s: float
) -> PrinterView | None:
    """Of the free printers of another kind, the one on which it ends soonest; None where there is none."""
    ready = [
        p
        for p in free
        if _other_kind(plate, p) and p.name not in plate.failed_on and _could_start(plate, p, rules, now_s)
    ]
    if plate.places == 0 or not ready:
        return None
    return min(ready, key=lambda p: (_seconds_sliced_for(plate, p), p.name))


def _could_start(plate: PlateView, printer: PrinterView, rules: Rules, now_s: float) -> bool:
    enough = short_of_filament(plate, printer, printer.grams) is None
    return enough and rules.start(plate, printer, now_s).at_s == now_s


def _seconds_sliced_for(plate: PlateView, printer: PrinterView) -> float:
    """What it should take, sliced for that printer: a finer nozzle lays thinner and narrower lines.

    That a coarser one is quicker is not counted on.
    """
    finer = 1.0
    if plate.need.nozzle_mm is not None:
        finer = max(1.0, (plate.need.nozzle_mm / printer.kind.nozzle_mm) ** 2)
    prelude_s = plate.heating_s
    return prelude_s + (seconds_on(plate, printer) - prelude_s) * finer
