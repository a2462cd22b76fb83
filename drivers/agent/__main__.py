"""``python -m drivers.agent``: one agent."""

from __future__ import annotations

import argparse
import fcntl
import logging
import os
import sys
import time
from pathlib import Path

from drivers.agent.loop import Agent
from drivers.clock import Clock
from drivers.errors import AgentError
from drivers.profiles import PROFILES

LOCK = "lock"
_LOCK_TRIES, _LOCK_WAIT_S = 20, 0.05


def lock(folder: Path) -> int:
    """Hold the folder for as long as the process lives; whoever only looks (`client.alive`) lets go at once.

    Raises
    ------
    AgentError
        Another agent has it.
    """
    descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    for _ in range(_LOCK_TRIES):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOCK_WAIT_S)
        else:
            return descriptor
    os.close(descriptor)
    raise AgentError(f"{folder}: another agent has this printer: end that first")


def main() -> int:
    """Parse the command line, take the folder's lock, run."""
    parser = argparse.ArgumentParser(prog="python -m drivers.agent", description=__doc__)
    parser.add_argument("--printer", required=True, help="its name in the fleet")
    parser.add_argument("--model", required=True, choices=sorted(PROFILES))
    parser.add_argument("--port", required=True, help="a device path or sim://MODEL")
    parser.add_argument("--folder", required=True, type=Path)
    parser.add_argument("--scale", type=float, default=1.0, help="farm seconds in a wall second")
    parser.add_argument(
        "--anchor", type=float, default=0.0, help="when both clocks agreed, seconds since 1970"
    )
    given = parser.parse_args()
    logging.basicConfig(
        stream=sys.stdout, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    folder = given.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        lock(folder)
    except AgentError as error:
        logging.error("%s", error)
        return 1
    clock = Clock(given.scale, given.anchor)
    Agent(given.printer, PROFILES[given.model], given.port, folder, clock).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
