"""The process that owns one printer's serial port. It goes on printing whatever happens to the daemon.

`loop` is its one select loop, `server` its socket, `requests` what the daemon asks for, `status` what it
reports. `board` has the port with link and session, `idle_watch` judges a board without a print, `recorder`
writes changes to the journal, `alarm` cuts the mains, `spool` has the files.
"""

from drivers.agent.idle_watch import CARD, IdleWatch
from drivers.agent.loop import Agent

__all__ = ["CARD", "Agent", "IdleWatch"]
