"""Lock that keeps the host awake while a print is open."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from drivers.agent.sleep_inhibitor import Inhibitor

# Like the lock of systemd-inhibit, this lock exists while the command runs.
HOLD_COMMAND = 'echo "$1" > "$0"; shift; "$@"; rm "$0"'


def wait_for_file(path: Path, exists: bool) -> bool:
    deadline_s = time.monotonic() + 10.0
    while path.exists() != exists and time.monotonic() < deadline_s:
        select.select([], [], [], 0.01)
    return path.exists() == exists


def test_lock_is_held_while_a_print_is_open(tmp_path: Path):
    lock = tmp_path / "lock"
    inhibitor = Inhibitor("um2-01", is_simulated=False, command=["sh", "-c", HOLD_COMMAND, str(lock)])
    for _ in range(2):
        inhibitor.set_lock(True)
        inhibitor.set_lock(True)
        assert wait_for_file(lock, exists=True)
        inhibitor.set_lock(False)
        assert wait_for_file(lock, exists=False)


def test_lock_is_released_when_the_agent_is_killed(tmp_path: Path):
    lock = tmp_path / "lock"
    text = (
        "import sys, time; from drivers.agent.sleep_inhibitor import Inhibitor\n"
        f"Inhibitor('a', is_simulated=False, command=['sh', '-c', {HOLD_COMMAND!r}, {str(lock)!r}])"
        ".set_lock(True)\n"
        "time.sleep(60)"
    )
    agent = subprocess.Popen([sys.executable, "-c", text], cwd=Path(__file__).parents[3])
    try:
        assert wait_for_file(lock, exists=True)
    finally:
        os.kill(agent.pid, signal.SIGKILL)
        agent.wait()
    assert wait_for_file(lock, exists=False)


def test_no_lock_is_held_without_inhibitors_or_for_a_simulated_printer(tmp_path: Path):
    for inhibitor in (
        Inhibitor("a", is_simulated=False, command=[str(tmp_path / "no-such-program")]),
        Inhibitor("a", is_simulated=True),
    ):
        inhibitor.set_lock(True)
        inhibitor.set_lock(False)
