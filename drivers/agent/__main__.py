"""``python -m drivers.agent --folder FOLDER``: one agent, for the printer that `start.json` there names."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from drivers import start
from drivers.agent.inhibit import Inhibitor
from drivers.agent.loop import Agent
from drivers.errors import AgentError
from drivers.locks import AGENT_LOCK, hold, sign
from drivers.profiles import PROFILES


def main() -> int:
    """Parse the command line, take the folder's lock, run."""
    parser = argparse.ArgumentParser(prog="python -m drivers.agent", description=__doc__)
    parser.add_argument("--folder", required=True, type=Path)
    folder = parser.parse_args().folder.absolute()
    logging.basicConfig(
        stream=sys.stdout, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    try:
        given = start.read(folder)
        profile = PROFILES.get(given.model)
        if profile is None:
            raise AgentError(f"no printer model {given.model!r}; use one of {', '.join(sorted(PROFILES))}")
    except AgentError as error:
        logging.error("%s", error)
        return 1
    lock = hold(folder / AGENT_LOCK)
    if lock is None:
        logging.error("%s: another agent has this printer: end that first", folder)
        return 1
    sign(lock)
    inhibitor = Inhibitor(given.printer, simulated=given.port.startswith("sim://"))
    Agent(given.printer, profile, given.port, folder, given.clock, given.power_off_cmd, inhibitor).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
