"""Which waiting plates are being made otherwise than planned: when it is begun, and what comes of it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from farm.errors import FarmError
from farm.model import Hold, HoldCode, Plate, PrintState, Verdict
from farm.planning.replanning import policy
from farm.planning.replanning.replan import Remade
from farm.scheduling.hold_reasons import listed
from farm.scheduling.situation import PlateView, PrinterView
from farm.scheduling.situation_builder import plate_views
from farm.scheduling.spares import takes_spare
from farm.scheduling.start_rules import Rules
from farm.state import events as ev
from farm.state.books import Books

log = logging.getLogger(__name__)

_LOOK_S = 10.0  # wall seconds between two looks at what waits
Begin = Callable[[Plate, tuple[str, ...], bool], None]


@dataclass(frozen=True, slots=True)
class _Making:
    printers: tuple[str, ...]
    cut: bool


class Otherwise:
    """What is begun is in memory only: a daemon that dies leaves plates that wait, and the next one decides.

    Parameters
    ----------
    rules, clock
        The farm's.
    begin
        Starts the work on a plate for these printers, and returns at once; true where its part is cut.
    """

    def __init__(self, rules: Rules, clock: Clock, begin: Begin) -> None:
        self._rules, self._clock, self._begin = rules, clock, begin
        self._making: dict[str, _Making] = {}
        self._seen: set[tuple[str, int]] = set()  # failed plates, and of how many prints: looked at once
        self._tried: set[tuple[str, int, str | None, float]] = set()  # and the kind of printer: it was no use
        self._looked_s = float("-inf")

    @property
    def promised(self) -> frozenset[str]:
        """The printers that something is being made for."""
        return frozenset(name for making in self._making.values() for name in making.printers)

    def clock_set(self) -> None:
        """The host's clock was set: when it was looked last says nothing any more."""
        self._looked_s = float("-inf")

    def holds(self) -> dict[str, Hold]:
        """The plates whose parts are being cut: meanwhile they go to no printer."""
        return {
            name: Hold(
                code=HoldCode.CUT_AGAIN,
                text=f"it failed, and is being cut for {listed(making.printers)}: that is sooner",
            )
            for name, making in self._making.items()
            if making.cut
        }

    def look_at_failures(
        self, books: Books, waiting: Sequence[PlateView], printers: Sequence[PrinterView]
    ) -> None:
        """Have what has just failed cut, where that is worth it; before it is given to a printer again."""
        for view in waiting:
            plate = books.plates[view.id]
            key = (plate.id, len(plate.prints))
            if key in self._seen or not _failed(books, plate) or not _may_be_remade(books, plate):
                continue
            self._seen.add(key)
            now_s, scale = self._clock.now(), self._clock.scale
            wish = policy.to_cut(view, waiting, printers, self._rules, now_s, scale)
            if wish is not None:
                self._start(plate, wish.printers, cut=True)

    def look_at_waits(
        self,
        books: Books,
        waiting: Sequence[PlateView],
        holds: Mapping[str, Hold],
        printers: Sequence[PrinterView],
        kept: frozenset[str],
    ) -> None:
        """Have what waits for its own kind of printer sliced for another kind that is free.

        Parameters
        ----------
        waiting, holds
            What was offered to the printers, and what of it none took, with why.
        printers, kept
            The fleet after that, and the free ones that are kept for what fails.
        """
        now_s = self._clock.now()
        if now_s - self._looked_s < _LOOK_S * self._clock.scale:
            return
        self._looked_s = now_s
        promised = self.promised
        free = [p for p in printers if p.obstacle() is None and p.name not in promised]
        fleet = {printer.name: printer for printer in printers}
        for view in sorted(waiting, key=lambda view: view.turn):
            plate = books.plates[view.id]
            if not free or view.id in self._making or not _may_be_remade(books, plate):
                continue
            if view.id not in holds or not policy.waits_for_a_kind(holds[view.id].code):
                continue
            mine = [
                p
                for p in free
                if (plate.id, len(plate.prints), p.kind.kin, p.kind.nozzle_mm) not in self._tried
                and (p.name not in kept or takes_spare(view, fleet))
            ]
            wish = policy.to_slice(view, waiting, printers, mine, self._rules, now_s, self._clock.scale)
            if wish is not None:
                self._start(plate, (wish.printer,), cut=False)
                free = [p for p in free if p.name != wish.printer]

    def ended(
        self,
        name: str,
        result: Remade | FarmError,
        books: Books,
        waiting: Sequence[PlateView],
        printers: Sequence[PrinterView],
    ) -> ev.PlateReplaced | None:
        """What came of it, as an event; None where the plate stays as it is.

        Parameters
        ----------
        waiting
            All that is offered to the printers now, with those plates that are being cut.
        """
        making = self._making.pop(name, None)
        plate, now_s = books.plates[name], self._clock.now()
        view = next((view for view in waiting if view.id == name), None)
        if making is None or view is None:
            return None  # it was cancelled, or is printed by now
        kinds = {p.name: p.kind for p in printers}
        for kind in (kinds[printer] for printer in making.printers if printer in kinds):
            self._tried.add((plate.id, len(plate.prints), kind.kin, kind.nozzle_mm))
        if isinstance(result, FarmError):
            log.warning("plate %s stays as it is: %s", name, result)
            return None
        new = [
            p.model_copy(update={"prints": plate.prints, "counted_from": plate.counted_from})
            for p in result.plates
        ]
        views = list(plate_views(new, books))
        instead = [*(other for other in waiting if other.id != name), *views]
        if making.cut:
            before_s = policy.whole_s(view, waiting, printers, self._rules, now_s, self._clock.scale)
        else:
            before_s = policy.ends_s(view, waiting, printers, self._rules, now_s)
        there_s = max(policy.ends_s(one, instead, printers, self._rules, now_s) for one in views)
        there_s += policy.JOIN_S * len(views) if making.cut else 0.0
        if not policy.sooner(before_s, there_s, now_s):
            log.info("plate %s stays as it is: made otherwise it would not be there sooner", name)
            return None
        # Where that cannot be booked (a full disk), the plate waits on, and is looked at again.
        self._seen.discard((plate.id, len(plate.prints)))
        self._tried = {key for key in self._tried if key[0] != plate.id}
        return ev.PlateReplaced(
            at_s=now_s,
            plate=name,
            parts=result.parts,
            plates=result.plates,
            picture=result.picture,
            assembly=result.assembly,
            decomposition=result.decomposition,
        )

    def _start(self, plate: Plate, printers: tuple[str, ...], cut: bool) -> None:
        log.info("plate %s is %s for %s", plate.id, "cut" if cut else "sliced again", " ".join(printers))
        self._making[plate.id] = _Making(printers, cut)
        self._begin(plate, printers, cut)


def _failed(books: Books, plate: Plate) -> bool:
    last = books.prints[plate.prints[-1]] if plate.prints else None
    if last is None:
        return False
    return last.state is PrintState.FAILED or last.verdict is Verdict.BAD


def _may_be_remade(books: Books, plate: Plate) -> bool:
    """A person's own G-code stays as it is, and so does what a person has approved."""
    job = books.jobs[plate.job]
    meshes = [books.parts[name].file for name in plate.parts if books.parts[name].file.endswith(".stl")]
    return not job.options.hold and len(plate.parts) == len(meshes) == 1
