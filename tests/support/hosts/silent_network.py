"""Connection to another host over a network that can lose all packets without closing it.

`SilentRoute` simulates the network and the other host's sshd, in threads of the test. Run as a program, this
module takes the place of ssh.
"""

import os
import select
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

_POLL_S = 0.05


class SilentRoute:
    """Network that delivers the data sent during a cut after the cut, as TCP does.

    It delays the end of a connection in the same way.
    """

    def __init__(self) -> None:
        self._cut_event = threading.Event()
        self._closed_event = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.ssh = f"{sys.executable} {Path(__file__)} {self._listener.getsockname()[1]}"
        self.bridges: list[subprocess.Popen[bytes]] = []  # oldest first
        self._threads = [threading.Thread(target=self._accept_connections, daemon=True)]
        self._threads[0].start()

    def cut(self) -> None:
        self._cut_event.set()

    def reconnect(self) -> None:
        self._cut_event.clear()

    def close(self) -> None:
        self._closed_event.set()
        for thread in self._threads:
            thread.join(10.0)
        for bridge in self.bridges:
            bridge.wait(10.0)
        self._listener.close()

    def _accept_connections(self) -> None:
        while not self._closed_event.is_set():
            if self._cut_event.is_set() or not select.select([self._listener], [], [], _POLL_S)[0]:
                self._closed_event.wait(_POLL_S)
                continue
            caller, _ = self._listener.accept()
            thread = threading.Thread(target=self._forward_connection, args=(caller,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _forward_connection(self, caller: socket.socket) -> None:
        command = b""
        while not command.endswith(b"\n"):
            command += caller.recv(1)
        bridge = subprocess.Popen(
            ["sh", "-c", "exec env " + command.decode()], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.bridges.append(bridge)
        assert bridge.stdin is not None and bridge.stdout is not None
        pairs = {caller.fileno(): bridge.stdin.fileno(), bridge.stdout.fileno(): caller.fileno()}
        with caller, bridge.stdin, bridge.stdout, suppress(OSError):
            while not self._closed_event.is_set():
                if self._cut_event.is_set():
                    self._closed_event.wait(_POLL_S)
                    continue
                for readable in select.select([*pairs], [], [], _POLL_S)[0]:
                    data = os.read(readable, 65536)
                    if not data:
                        return
                    while data:
                        data = data[os.write(pairs[readable], data) :]


def main() -> None:
    """Run ``silent_network.py PORT -- HOST COMMAND``."""
    with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as connection:
        connection.sendall(sys.argv[-1].encode() + b"\n")
        pairs = {0: connection.fileno(), connection.fileno(): 1}
        while True:
            for readable in select.select([*pairs], [], [])[0]:
                data = os.read(readable, 65536)
                if not data:
                    return
                while data:
                    data = data[os.write(pairs[readable], data) :]


if __name__ == "__main__":
    main()
