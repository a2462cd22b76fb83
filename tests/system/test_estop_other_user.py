"""Emergency stop by another user of this host, while the daemon and the agent hang."""

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

from farms.real_farm import RealFarm

NOBODY_UID = 65534
CLIENT_COUNT = 80  # clients that connect and send no request
ESTOP_AS_USER = """
import os, sys
from farm.cli.main import app
os.setgroups([]); os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
app(["estop", "--json", "--socket", sys.argv[2]])
"""


def connect(path):
    client_socket = socket.socket(socket.AF_UNIX)
    client_socket.connect(str(path))
    return client_socket


@pytest.mark.system
@pytest.mark.skipif(os.getuid() != 0, reason="needs root to become another user")
def test_member_of_the_group_stops_a_printer_whose_daemon_and_agent_hang(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    shared_folder = Path(tempfile.mkdtemp())
    shared_folder.chmod(0o755)
    path = shared_folder / "estop.sock"
    command = [
        sys.executable,
        "-m",
        "farm.cli.estop_server",
        "--state",
        farm.state,
        "--fleet",
        farm.fleet,
    ]
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        os.chown(path, -1, NOBODY_UID)
        path.chmod(0o660)
        listener.listen(128)
        stopped_pids, server = [], None
        try:
            farm.up()
            stopped_pids += [farm.read_status()["daemon"]["pid"], farm.read_printer("um2-01")["agent_pid"]]
            for pid in stopped_pids:
                os.kill(pid, signal.SIGSTOP)
            arguments = [sys.executable, "-c", ESTOP_AS_USER, str(NOBODY_UID), shared_folder / "farm.sock"]
            idle_clients = [connect(path) for _ in range(CLIENT_COUNT)]
            server = subprocess.Popen(command, stdin=listener)  # as systemd does
            client = subprocess.Popen(arguments, stdout=subprocess.PIPE)
            output, _ = client.communicate(timeout=120)
            for client_socket in idle_clients:
                client_socket.close()
            [row] = json.loads(output)["printers"]
            assert (client.returncode, row["printer"], row["seen_off"]) == (0, "um2-01", True)
        finally:
            if server is not None:
                server.kill()
                server.wait()
            for pid in stopped_pids:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
            farm.end()
            shutil.rmtree(shared_folder)
