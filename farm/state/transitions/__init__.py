"""Application of events to the books, as the tables of `farm.state.lifecycles` allow. Pure."""

from farm.state.transitions import farm_wide, jobs, plates, printers, prints  # register the rules
from farm.state.transitions.apply import apply

__all__ = ["apply", "farm_wide", "jobs", "plates", "printers", "prints"]
