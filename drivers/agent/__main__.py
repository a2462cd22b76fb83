"""``python -m drivers.agent``: one agent."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from drivers.agent.loop import Agent
from drivers.clock import Clock
from drivers.locks import AGENT_LOCK, hold, sign
from drivers.profiles import PROFILES


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
    parser.add_argument("--power-off-cmd", help="what takes the mains from this printer")
    given = parser.parse_args()
    logging.basicConfig(
        stream=sys.stdout, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    folder = given.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    lock = hold(folder / AGENT_LOCK)
    if lock is None:
        logging.error("%s: another agent has this printer: end that first", folder)
        return 1
    sign(lock, printer=given.printer, model=given.model, port=given.port, power_off_cmd=given.power_off_cmd)
    clock = Clock(given.scale, given.anchor)
    profile = PROFILES[given.model]
    Agent(given.printer, profile, given.port, folder, clock, given.power_off_cmd).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
