"""Run the agent of the printer in FOLDER/start.json: ``python -m drivers.agent --folder FOLDER``."""

from __future__ import annotations

import argparse
import logging
import sys
from contextlib import suppress
from pathlib import Path

from drivers.agent.loop import Agent
from drivers.agent.sleep_inhibitor import Inhibitor
from drivers.errors import AgentError
from drivers.locks import AGENT_LOCK, acquire_lock, is_locked, write_pid
from drivers.printers import PROFILES
from drivers.records import JOURNAL, StartFile, read_journal
from drivers.safety import StopTarget, stop_board


def main() -> int:
    """Parse the command line, take the folder's lock, and run the agent."""
    parser = argparse.ArgumentParser(prog="python -m drivers.agent", description=__doc__)
    parser.add_argument("--folder", required=True, type=Path)
    folder = parser.parse_args().folder.absolute()
    logging.basicConfig(
        stream=sys.stdout, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    try:
        start = StartFile.read(folder)
        if start.model not in PROFILES:
            raise AgentError(f"no printer model {start.model!r}; use one of {', '.join(sorted(PROFILES))}")
    except AgentError as error:
        logging.error("%s", error)
        return 1
    inhibitor = Inhibitor(start.printer, is_simulated=start.port.startswith("sim://"))
    try:
        if not _take_lock(folder):
            logging.error("%s: another agent has this printer; end it first", folder)
            return 1
        agent = Agent(start, folder, inhibitor)
    except OSError as error:
        logging.error("%s: cannot be written (%s); check its disk", folder, error)
        _switch_off_heaters(start, folder)
        return 1
    agent.run()
    return 0


def _take_lock(folder: Path) -> bool:
    """Take the folder's lock until this process ends; return False if another agent has it."""
    try:
        lock = acquire_lock(folder / AGENT_LOCK)
    except OSError:
        if is_locked(folder / AGENT_LOCK):
            return False
        raise
    if lock is not None:
        with suppress(OSError):  # even on a full disk the agent must run, to switch heaters off
            write_pid(lock)
    return lock is not None


def _switch_off_heaters(start: StartFile, folder: Path) -> None:
    """Switch off heaters that the last agent left on; called if this agent cannot run."""
    if read_journal(folder / JOURNAL)[0].may_be_hot:
        result = stop_board(StopTarget.from_agent(start, folder))
        logging.error("%s: its last agent left a print open: %s", start.printer, result.text)


if __name__ == "__main__":
    sys.exit(main())
