"""Inspection of submissions and of the fleet file, before anything is planned.

Functions that run in workers are listed in `farm.planning.tasks`; their modules load numpy.
"""

from farm.planning.inspection.fleet_check import complete_section
from farm.planning.inspection.materials import resolve_filament

__all__ = [
    "complete_section",
    "resolve_filament",
]
