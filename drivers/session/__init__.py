"""One print on one board, without I/O."""

from drivers.session.context import Pace, SessionContext
from drivers.session.session import Session

__all__ = ["Pace", "Session", "SessionContext"]
