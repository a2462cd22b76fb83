"""Schedule of an assembly: the time of each step, and an order in which a person can work while glue dries.

The times are estimates. For models with 6 to 12 parts, their sum divided by the number of parts agrees with
the 3.6 minutes per part in the literature (`engines.guillotine.ASSEMBLY_S`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

DRYING_S = 120.0
"""Estimated time until a glued body can be handled; the cyanoacrylate itself sets in 30 s."""
CLEANING_S = 30.0  # time to remove the brim of a part before its first use
HANDLING_S = 45.0  # time to find two bodies, fit them without glue, and read the instructions
HOLDING_S = 30.0  # time to press the bodies together until the glue holds
UNSTEADY_HOLDING_S = 30.0  # additional time if the lower body does not stand by itself
ALIGNMENT_S = 10.0  # time to align one joint
GLUING_S_PER_MM2 = 0.005  # time to apply the glue


@dataclass(frozen=True, slots=True)
class StepWork:
    """Work of one step of the assembly.

    Attributes
    ----------
    bodies
        Parts of each of the two bodies that the step joins.
    joint_count
        Number of joints that are glued.
    glue_mm2
        Area of these joints.
    is_steady
        Whether the lower body stands by itself.
    """

    bodies: tuple[frozenset[int], frozenset[int]]
    joint_count: int
    glue_mm2: float
    is_steady: bool

    @property
    def work_s(self) -> float:
        """Estimated time that a person needs, without the time in which glue dries."""
        single_count = sum(len(body) == 1 for body in self.bodies)
        glue_s = (
            HOLDING_S + ALIGNMENT_S * self.joint_count + GLUING_S_PER_MM2 * self.glue_mm2
            if self.joint_count
            else 0.0
        )
        return (
            CLEANING_S * single_count + HANDLING_S + glue_s + (0.0 if self.is_steady else UNSTEADY_HOLDING_S)
        )

    @property
    def parts(self) -> frozenset[int]:
        """Parts of the resulting body."""
        return self.bodies[0] | self.bodies[1]


def order_steps(steps: Sequence[StepWork], drying_s: float = DRYING_S) -> list[tuple[int, float]]:
    """Order the steps so that a person can work while glue dries.

    The next step is the first one in the given order whose bodies are dry. If there is none, the person waits
    for the step whose bodies will be dry first.

    Parameters
    ----------
    steps
        Steps, each after those that make its bodies.
    drying_s
        Time until a glued body can be handled.

    Returns
    -------
    list of (int, float)
        Index and start in seconds of each step, in the order of work.
    """
    predecessors = _find_predecessors(steps)
    dry_at_s: dict[int, float] = {}
    order: list[tuple[int, float]] = []
    now_s = 0.0
    while len(order) < len(steps):
        ready_s = {
            i: max([now_s, *(dry_at_s[j] for j in predecessors[i])])
            for i in range(len(steps))
            if i not in dry_at_s and all(j in dry_at_s for j in predecessors[i])
        }
        number = min(ready_s, key=lambda i: (ready_s[i], i))
        order.append((number, ready_s[number]))
        now_s = ready_s[number] + steps[number].work_s
        dry_at_s[number] = now_s + drying_s
    return order


def compute_critical_path_s(steps: Sequence[StepWork], drying_s: float = DRYING_S) -> float:
    """Compute the minimum time of an assembly with enough people: the longest chain of work and drying.

    Parameters
    ----------
    steps
        Steps, each after those that make its bodies.
    drying_s
        Time until a glued body can be handled; it does not count after the last step of the chain.

    Returns
    -------
    float
        Seconds.
    """
    ends_s: list[float] = []
    for step, predecessors in zip(steps, _find_predecessors(steps), strict=True):
        ends_s.append(max((ends_s[j] + drying_s for j in predecessors), default=0.0) + step.work_s)
    return max(ends_s, default=0.0)


def _find_predecessors(steps: Sequence[StepWork]) -> list[list[int]]:
    """List, for each step, the steps that make its bodies."""
    step_by_body = {step.parts: i for i, step in enumerate(steps)}
    return [[step_by_body[body] for body in step.bodies if body in step_by_body] for step in steps]
