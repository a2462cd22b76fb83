"""Measured daemon as a process, a follower of its events, and a receiver of its notices."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from http.client import HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from bench.fleets.measured_daemon import MEASUREMENTS_FILE
from bench.process_use import read_memory_mb
from farm.cli.client import Client
from farm.cli.client.connections import SocketConnection
from farm.errors import FarmError

_STOP_TIMEOUT_S = 60.0
_READ_TIMEOUT_S = 60.0


class Daemon:
    """Daemon on a state folder, with its CPU time and memory.

    Parameters
    ----------
    folder
        State folder with `fleet.yaml`.
    profile
        File for the daemon's profile.
    ssh
        Value of FARM_SSH; None for that of this process.
    """

    def __init__(self, folder: Path, profile: Path | None, ssh: str | None = None) -> None:
        command = [sys.executable, "-m", "bench.fleets.measured_daemon", str(folder)]
        command += [] if profile is None else [str(profile.absolute())]
        env = os.environ | ({} if ssh is None else {"FARM_SSH": ssh})
        self.started_s = time.monotonic()
        with (folder / "daemon.log").open("wb") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log, env=env)
        self._folder = folder
        self.socket = folder / "farm.sock"
        self.client = Client(self.socket)

    def read_cpu_s(self) -> float:
        """Return the CPU seconds of all threads of the daemon."""
        return time.clock_gettime((~self._process.pid << 3) | 2)

    def read_memory_mb(self) -> float:
        """Return the resident memory of the daemon in MB, without that of its workers."""
        return read_memory_mb(self._process.pid)

    def is_answering(self) -> bool:
        """Check whether the daemon answers."""
        try:
            self.client.fetch_names()
        except FarmError:
            if self._process.poll() is not None:
                raise RuntimeError((self._folder / "daemon.log").read_text()[-2000:]) from None
            return False
        return True

    def stop(self) -> dict[str, list[float]]:
        """Stop the daemon without ending prints; return its own measurements."""
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(_STOP_TIMEOUT_S)
        measurements: dict[str, list[float]] = json.loads((self._folder / MEASUREMENTS_FILE).read_text())
        return measurements

    def kill(self) -> None:
        """Kill the daemon in any state."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


@dataclass(frozen=True, slots=True)
class ReceivedEvent:
    """Event that a follower has received, at a time of `time.monotonic`."""

    at_s: float
    fields: dict[str, Any]


@dataclass
class EventFollower:
    """Follower of `/events` in its own thread, with all events received."""

    socket: Path
    events: list[ReceivedEvent] = field(default_factory=list)

    def __post_init__(self) -> None:
        threading.Thread(target=self._follow, daemon=True).start()

    def count(self, kind: str, since_s: float) -> int:
        """Count the events of a kind since a time."""
        return sum(event.fields["kind"] == kind and event.at_s >= since_s for event in self.events)

    def find(self, kind: str, printer: str, since_s: float) -> ReceivedEvent | None:
        """Find the first event of a kind on a printer since a time."""
        return next(
            (
                event
                for event in list(self.events)
                if event.at_s >= since_s
                and event.fields["kind"] == kind
                and event.fields["printer"] == printer
            ),
            None,
        )

    def _follow(self) -> None:
        connection = SocketConnection(self.socket, 1.0, _READ_TIMEOUT_S)
        with suppress(OSError, HTTPException):
            connection.request("GET", "/events")
            answer = connection.getresponse()
            while line := answer.readline():
                if line.startswith(b"data: "):
                    self.events.append(ReceivedEvent(time.monotonic(), json.loads(line[6:])))


class NoticeReceiver:
    """HTTP server that stores the notices sent to it.

    Attributes
    ----------
    lines
        Lines of all notices, in the order of arrival.
    """

    def __init__(self) -> None:
        lines = self.lines = list[str]()

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["content-length"])))
                lines.extend(body["message"].splitlines())
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.url = f"json://127.0.0.1:{self._server.server_port}/"
        """Address in the format of apprise."""

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()
