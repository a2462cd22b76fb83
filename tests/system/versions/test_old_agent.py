"""The current daemon with an agent of an earlier version, whose sources are in the history."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.remote import is_alive, kill_agent
from farms.real_farm import RealFarm, wait_for

ROOT = Path(__file__).parents[3]
OLD_COMMIT = "00f76ab"  # the last commit whose agents do not report their protocol


def write_old_sources(folder):
    """Write the earlier drivers into a folder; skip the test if the history lacks them."""
    command = ["git", "-C", str(ROOT), "archive", OLD_COMMIT, "drivers"]
    archive = subprocess.run(command, check=False, capture_output=True)
    if archive.returncode != 0:
        pytest.skip("the history does not go back so far")
    folder.mkdir()
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


@pytest.mark.system
def test_agent_of_an_earlier_version_is_detected_and_replaced(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    sources = write_old_sources(tmp_path / "then")
    agent = farm.state / "agents" / "um2-01"
    old_agent = None
    try:
        farm.up()
        farm.kill_daemon()
        wait_for("the agent's end", lambda: kill_agent(agent))
        command = [sys.executable, "-m", "drivers.agent", "--folder", str(agent)]
        old_agent = subprocess.Popen(command, cwd=sources, stderr=subprocess.DEVNULL, start_new_session=True)
        # Without a running agent, the daemon would start one of its own version.
        wait_for("the old agent", lambda: is_alive(agent))
        farm.run_checked("up")
        attention_reason = wait_for(
            "the daemon to find the agent", lambda: farm.read_printer("um2-01")["look"]
        )
        assert "farm up --replace um2-01" in attention_reason
        assert farm.read_printer("um2-01")["agent_pid"] == old_agent.pid
        assert "needs_a_look" in farm.read_printer("um2-01")["hold"]["code"]
        # The daemon does not repeat requests that this agent cannot answer.
        assert len((farm.state / "daemon.log").read_text().splitlines()) < 50
        assert "was replaced" in farm.run_checked("up", "--replace", "um2-01")
        assert old_agent.wait(60.0) is not None
        wait_for("another agent", lambda: farm.read_printer("um2-01")["state"] == "idle")
        assert farm.read_printer("um2-01")["agent_pid"] != old_agent.pid
    finally:
        farm.end()
        if old_agent is not None and old_agent.poll() is None:
            os.kill(old_agent.pid, signal.SIGKILL)
            old_agent.wait()
