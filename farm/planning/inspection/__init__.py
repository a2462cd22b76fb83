"""Inspection of submissions and of the fleet file, before anything is planned.

Functions that run in workers are listed in `farm.planning.tasks`; their modules load numpy.
"""

from farm.planning.inspection.fleet_check import find_mistake

__all__ = [
    "find_mistake",
]
