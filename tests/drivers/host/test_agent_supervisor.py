"""Supervisor of one agent whose process never takes the agent's lock."""

import asyncio
import subprocess
import sys

from drivers.host import agent_supervisor
from drivers.host.agent_supervisor import AgentSupervisor
from drivers.records import StartFile

SLEEP_COMMAND = [sys.executable, "-c", "import time; time.sleep(600)"]


def test_agent_that_never_takes_its_lock_can_be_killed_and_counts_as_ended(tmp_path, monkeypatch):
    processes = []

    def start(*_: object) -> subprocess.Popen:
        processes.append(subprocess.Popen(SLEEP_COMMAND))
        return processes[-1]

    monkeypatch.setattr(agent_supervisor, "start_agent", start)

    async def run_scenario() -> None:
        supervisor = AgentSupervisor(
            StartFile("a", "ultimaker2_plus", "sim://x"), tmp_path, None, lambda: None
        )
        supervisor.ensure_running()
        assert supervisor.is_running and not supervisor.is_alive
        assert (supervisor.start_count, supervisor.last_ended_start) == (1, 0)
        supervisor.kill()
        processes[0].wait(20.0)
        assert not supervisor.is_running
        supervisor.ensure_running()
        assert supervisor.last_ended_start == 1
        supervisor.kill()
        await supervisor.close()

    asyncio.run(run_scenario())
    for process in processes:
        process.kill()
        process.wait()
