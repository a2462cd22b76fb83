"""Application of events to the books, as the tables of `farm.state.lifecycles` allow. Pure."""

from farm.state.transitions import jobs, keys, plates, printers, prints, queue  # register the rules
from farm.state.transitions.apply_event import apply, list_undeclared_changes

__all__ = ["apply", "jobs", "keys", "list_undeclared_changes", "plates", "printers", "prints", "queue"]
