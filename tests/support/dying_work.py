"""Work for worker processes that ends badly; in a module that they can import."""

import os
import signal

from farm.errors import FarmError


def die_once(marker):
    """Die as a process killed for its memory does, the first time."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def complain():
    raise FarmError("no such thing")
