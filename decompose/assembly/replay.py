"""Replay of an assembly backwards: a check that does not trust the search."""

from __future__ import annotations

from collections.abc import Sequence

from decompose.assembly.blocking import collide
from decompose.assembly.order import Assembly
from decompose.geometry import Solid


def find_collisions(solids: Sequence[Solid], assembly: Assembly) -> list[str]:
    """Replay all steps backwards, and find those in which the moved body would run into the fixed one.

    Parameters
    ----------
    solids
        All parts, in the frame of the steps.

    Returns
    -------
    list of str
        A sentence for each fault; also for parts that occur in no step, or are joined before they are there.
    """
    faults = []
    bodies = {number: {number} for number in range(len(solids))}
    for n, step in enumerate(assembly.steps, 1):
        for side in (step.moved, step.fixed):
            loose = {frozenset(bodies[number]) for number in side}
            if set().union(*loose) != set(side):
                faults.append(f"step {n} takes a part out of a body that is glued")
        faults += [
            f"step {n}: part {moved + 1} runs into part {fixed + 1}"
            for moved in step.moved
            for fixed in step.fixed
            if collide(solids[moved], solids[fixed], step.direction)
        ]
        together = {*step.moved, *step.fixed}
        for number in together:
            bodies[number] = together
    return faults
