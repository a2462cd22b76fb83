"""Agent: the process that owns one printer's serial port, and continues printing if the daemon ends.

`loop` is its select loop, and `server` its socket; `requests` handles the daemon's requests, and `snapshots`
reports on the printer. `board` owns the port, the link and the session; `idle_watch` watches a board without
a print. `recorder` writes changes to the journal, `alarm` cuts the mains, and `spool` stores G-code files.
"""

from drivers.agent.idle_watch import SD_PRINT_REASON, IdleWatch
from drivers.agent.loop import Agent

__all__ = ["SD_PRINT_REASON", "Agent", "IdleWatch"]
