"""Replay of an assembly: checks of each step with the parts' solids, independent of the search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from decompose.assembly.blocking import make_frame
from decompose.assembly.order import Assembly, AssemblyStep
from decompose.assembly.shadow import cast_shadow
from decompose.geometry import Solid
from decompose.pieces import Joint

SAME_AXIS_COS = 1.0 - 1e-9  # minimum absolute cosine between two directions along the same axis


def find_order_faults(solids: Sequence[Solid], joints: Sequence[Joint], assembly: Assembly) -> list[str]:
    """Replay all steps, and find steps that cannot be carried out and joints that no step closes.

    Parameters
    ----------
    solids
        All parts, in the frame of the steps, in mm.
    joints
        Joints of the parts.
    assembly
        Steps; each of its `locked_sets` counts as one body.

    Returns
    -------
    list of str
        A sentence for each fault, with the numbers of the parts counted from 1.
    """
    return [*_replay_bodies(len(solids), joints, assembly), *_find_collisions(solids, assembly.steps)]


def _replay_bodies(count: int, joints: Sequence[Joint], assembly: Assembly) -> Iterator[str]:
    """Join the bodies step by step, and yield a sentence for each fault.

    A fault is a moved or fixed body of a step that is not exactly one body at that time, or a joint whose
    parts no step joins.
    """
    bodies = {number: frozenset({number}) for number in range(count)}
    for group in assembly.locked_sets:
        bodies |= dict.fromkeys(group, frozenset(group))
    for n, step in enumerate(assembly.steps, 1):
        for verb, side in (("moves", step.moved_parts), ("holds", step.fixed_parts)):
            body = bodies[side[0]]
            if not body.issuperset(side):
                yield f"step {n} {verb} {_name_parts(side)} together, but they are not joined yet"
            elif body != set(side):
                others = _name_parts(sorted(body.difference(side)))
                yield f"step {n} {verb} {_name_parts(side)} but not {others}, although they are joined"
        joined_body = frozenset((*step.moved_parts, *step.fixed_parts))
        bodies |= dict.fromkeys(joined_body, joined_body)
    for joint in joints:
        if joint.b not in bodies[joint.a]:
            yield f"no step joins {_name_parts((joint.a, joint.b))}"


def _find_collisions(solids: Sequence[Solid], steps: Sequence[AssemblyStep]) -> Iterator[str]:
    """Move the bodies of each step apart, and yield a sentence for each collision.

    The axes are examined one after another, because shadows take a lot of memory.
    """
    axes: list[np.ndarray] = []
    for step in steps:
        if not any(abs(float(axis @ step.direction)) > SAME_AXIS_COS for axis in axes):
            axes.append(step.direction)
    for axis in axes:
        frame = make_frame(axis)
        shadows = [cast_shadow(solid, frame) for solid in solids]
        for n, step in enumerate(steps, 1):
            cosine = float(axis @ step.direction)
            if abs(cosine) <= SAME_AXIS_COS:
                continue
            for moved in step.moved_parts:
                for fixed in step.fixed_parts:
                    if shadows[fixed].blocks(shadows[moved])[0 if cosine > 0.0 else 1]:
                        yield f"step {n}: part {moved + 1} runs into part {fixed + 1}"


def _name_parts(parts: Sequence[int]) -> str:
    """Name parts by their numbers, counted from 1."""
    return ("part " if len(parts) == 1 else "parts ") + ", ".join(str(number + 1) for number in parts)
