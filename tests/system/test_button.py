"""Another user of this host stops a printer, while daemon and agent hang."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

from real_farm import FARM, RealFarm

NOBODY = 65534
ANOTHER = """
import os, sys
from farm.cli.main import app
os.setgroups([]); os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
app(["estop", "--json", "--socket", sys.argv[2]])
"""


@pytest.mark.system
@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to be another user")
def test_another_member_of_the_group_stops_a_printer_whose_daemon_and_agent_hang(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    shared = Path(tempfile.mkdtemp())
    shared.chmod(0o755)
    path = shared / "estop.sock"
    command = [FARM, "estop", "--asked", "--state", farm.state, "--fleet", farm.fleet]
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        os.chown(path, -1, NOBODY)
        path.chmod(0o660)
        listening.listen()
        hung = []
        try:
            farm.up()
            hung += [farm.status()["daemon"]["pid"], farm.printer("um2-01")["agent_pid"]]
            for pid in hung:
                os.kill(pid, signal.SIGSTOP)
            words = [sys.executable, "-c", ANOTHER, str(NOBODY), shared / "farm.sock"]
            asking = subprocess.Popen(words, stdout=subprocess.PIPE)
            talk, _ = listening.accept()
            with talk:  # as systemd does it
                subprocess.run(command, stdin=talk, stdout=talk, check=True, timeout=120)
            said, _ = asking.communicate(timeout=60)
            [row] = json.loads(said)["printers"]
            assert (asking.returncode, row["printer"], row["seen_off"]) == (0, "um2-01", True)
        finally:
            for pid in hung:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
            farm.end()
            shutil.rmtree(shared)
