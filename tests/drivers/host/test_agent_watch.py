"""Watch over one agent whose process never takes the agent's lock."""

import asyncio
import subprocess
import sys

from drivers.host import agent_watch
from drivers.host.agent_watch import AgentWatch
from drivers.records import StartFile

SLEEP_COMMAND = [sys.executable, "-c", "import time; time.sleep(600)"]


def test_agent_that_never_takes_its_lock_can_be_killed_and_counts_as_ended(tmp_path, monkeypatch):
    processes = []

    def start(*_: object) -> subprocess.Popen:
        processes.append(subprocess.Popen(SLEEP_COMMAND))
        return processes[-1]

    monkeypatch.setattr(agent_watch, "start_agent", start)

    async def run_scenario() -> None:
        watch = AgentWatch(StartFile("a", "ultimaker2_plus", "sim://x"), tmp_path, None, lambda: None)
        watch.keep_alive()
        assert watch.is_running and not watch.is_alive
        assert (watch.start_count, watch.last_ended_start) == (1, 0)
        watch.kill()
        processes[0].wait(20.0)
        assert not watch.is_running
        watch.keep_alive()
        assert watch.last_ended_start == 1
        watch.kill()
        await watch.close()

    asyncio.run(run_scenario())
    for process in processes:
        process.kill()
        process.wait()
