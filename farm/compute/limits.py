"""Time limits for each kind of work in a pool."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limit:
    """Time limit of a kind of work, in wall seconds from its start in a worker.

    Attributes
    ----------
    work_name
        Name of the work, for messages.
    is_urgent
        True if the work is quick and a user is waiting for it; it then starts before other work.
    """

    work_name: str
    seconds: float
    is_urgent: bool = False


CHECKING_LIMIT = Limit("reading and checking the model", 600.0, is_urgent=True)
DECOMPOSING_LIMIT = Limit("decomposing", 1800.0)
DRAWING_LIMIT = Limit("drawing the parts", 1800.0)
SLICING_LIMIT = Limit("slicing a part", 2400.0)  # above CuraEngine's own limit (slicing.plate)
