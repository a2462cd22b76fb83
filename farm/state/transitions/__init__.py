"""Application of events to the books, if the tables of `farm.state.lifecycles` allow them. Pure."""

from farm.state.transitions import jobs, keys, plates, printers, prints, queue  # they register the rules
from farm.state.transitions.apply_event import apply, list_undeclared_changes

__all__ = ["apply", "jobs", "keys", "list_undeclared_changes", "plates", "printers", "prints", "queue"]
