"""``python -m drivers.agent --folder FOLDER``: one agent, for the printer that `start.json` there names."""

from __future__ import annotations

import argparse
import logging
import sys
from contextlib import suppress
from pathlib import Path

from drivers.agent.loop import Agent
from drivers.agent.sleep_inhibitor import Inhibitor
from drivers.errors import AgentError
from drivers.locks import AGENT_LOCK, held, hold, sign
from drivers.printers import PROFILES
from drivers.records import JOURNAL, StartFile, read_journal
from drivers.safety import StopTarget, stop_board


def main() -> int:
    """Parse the command line, take the folder's lock, run."""
    parser = argparse.ArgumentParser(prog="python -m drivers.agent", description=__doc__)
    parser.add_argument("--folder", required=True, type=Path)
    folder = parser.parse_args().folder.absolute()
    logging.basicConfig(
        stream=sys.stdout, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    try:
        given = StartFile.read(folder)
        profile = PROFILES.get(given.model)
        if profile is None:
            raise AgentError(f"no printer model {given.model!r}; use one of {', '.join(sorted(PROFILES))}")
    except AgentError as error:
        logging.error("%s", error)
        return 1
    inhibitor = Inhibitor(given.printer, simulated=given.port.startswith("sim://"))
    try:
        if not _mine(folder):
            logging.error("%s: another agent has this printer: end that first", folder)
            return 1
        agent = Agent(given.printer, profile, given.port, folder, given.clock, given.power_off_cmd, inhibitor)
    except OSError as error:
        logging.error("%s: cannot be written (%s); see to its disk", folder, error)
        _end_heat(given, folder)
        return 1
    agent.run()
    return 0


def _mine(folder: Path) -> bool:
    """Take the folder's lock for as long as this process lives; False where another agent has it."""
    try:
        lock = hold(folder / AGENT_LOCK)
    except OSError:
        if held(folder / AGENT_LOCK):
            return False
        raise
    if lock is not None:
        with suppress(OSError):  # a full disk: it prints nothing new, but the heat has to be ended
            sign(lock)
    return lock is not None


def _end_heat(given: StartFile, folder: Path) -> None:
    """End the heat of the last agent: nothing can be written, so nothing is printed."""
    if read_journal(folder / JOURNAL)[0].may_be_hot:
        stopped = stop_board(StopTarget.of_agent(given, folder))
        logging.error("%s: its last agent left a print behind: %s", given.printer, stopped.text)


if __name__ == "__main__":
    sys.exit(main())
