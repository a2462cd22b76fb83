"""Remote shell between the hosts of a test, over TCP.

``listen ADDRESS`` runs on a host, ``call FILE ... HOST COMMAND`` takes the place of ssh.

The shell has no keys and no keep-alive, because the farm itself has to detect a cut network.
"""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

READY_LINE = b"ready\n"
"""Line that the shell writes once it listens."""
_PORT = 2222
_CHUNK_BYTES = 65536
_CONNECT_TIMEOUT_S = 10.0


def listen(address: str) -> None:
    """Run a command for each connection, with the connection as its stdin and stdout."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel reaps the commands
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with socket.create_server((address, _PORT)) as server:
        sys.stdout.buffer.write(READY_LINE)
        sys.stdout.buffer.flush()
        while True:
            connection, _ = server.accept()
            with connection:
                command = b""
                while not command.endswith(b"\n") and (data := connection.recv(1)):
                    command += data
                subprocess.Popen(
                    ["sh", "-c", os.fsdecode(command)],
                    stdin=connection.fileno(),
                    stdout=connection.fileno(),
                    env=environment,
                )


def call(addresses: Path, host: str, command: str) -> None:
    """Run a command on a host and copy bytes until one end closes."""
    address = json.loads(addresses.read_text())[host]
    with socket.create_connection((address, _PORT), _CONNECT_TIMEOUT_S) as remote:
        remote.settimeout(None)
        remote.sendall(b"exec env " + command.encode() + b"\n")
        writers: dict[int, Callable[[bytes], object]] = {
            0: remote.sendall,
            remote.fileno(): lambda data: _write(1, data),
        }
        while True:
            for source in select.select(list(writers), [], [])[0]:
                data = os.read(source, _CHUNK_BYTES)
                if not data:
                    return
                writers[source](data)


def _write(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


if __name__ == "__main__":
    if sys.argv[1] == "listen":
        listen(sys.argv[2])
    else:
        with contextlib.suppress(BrokenPipeError):
            call(Path(sys.argv[2]), sys.argv[-2], sys.argv[-1])
