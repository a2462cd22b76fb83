"""Response times for other clients while thousands of clients on the network leave their requests incomplete.

``python -m bench.web.load [--connections N] [--seconds S] [--json]``. A real daemon has one simulated
printer, which prints. Each client on the network connects, and then stops: before it sends anything, in the
middle of a head, of a JSON body or of an upload, or without reading the answers to its requests. A client
that is disconnected connects again. Meanwhile another process requests `GET /status` on the Unix socket every
50 ms, and on the network every second. At the end, SIGTERM is sent to the daemon while all clients are
connected. The exit status is 1 if a goal is missed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import selectors
import signal
import socket
import sys
import tempfile
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import httpx
import trimesh

from bench.web.farm import WebFarm
from bench.web.upload_speed import POLL_S, TIMEOUT_S
from farm.api import NETWORK_PREFIX

GOALS = {
    "status_p99_ms": 100.0, "status_worst_ms": 1000.0, "network_failures_share": 0.1, "new_agents": 0,
    "printer_lost": 0, "shutdown_s": 30.0, "uploads_left": 0,
}  # fmt: skip
_NETWORK_PERIOD_S = 1.0
_SPARE_DESCRIPTORS = 100
_LARGE_BYTES = 10**9


def list_incomplete_requests(key: str) -> list[bytes]:
    """List incomplete requests of hanging clients."""
    head = f"Host: localhost\r\nX-Api-Key: {key}\r\n"
    status = f"GET {NETWORK_PREFIX}/status HTTP/1.1\r\n{head}\r\n"
    upload = (
        f"POST {NETWORK_PREFIX}/jobs?request_id=12345678&name=a.stl&size={_LARGE_BYTES} HTTP/1.1\r\n{head}"
    )
    form = f"POST /api/files/local HTTP/1.1\r\n{head}Content-Type: multipart/form-data; boundary=x\r\n"
    return [
        text.encode()
        for text in (
            "",
            "GET /heal",
            f"GET {NETWORK_PREFIX}/status HTTP/1.1\r\nX-Slow: ",
            f"POST {NETWORK_PREFIX}/printers/um2-01/fail HTTP/1.1\r\n{head}Content-Length: 20\r\n\r\n{{",
            f"{upload}Content-Length: {_LARGE_BYTES}\r\n\r\nsolid",
            f"{form}Content-Length: {_LARGE_BYTES}\r\n\r\n--x\r\nContent-Disposition: form-data; name=",
            status * 5,
            f"GET {NETWORK_PREFIX}/events HTTP/1.1\r\n{head}\r\n",
        )
    ]


class HangingClients:
    """Clients that stop in the middle of a request; a client that is disconnected connects again."""

    def __init__(self, port: int, key: str, number: int) -> None:
        self._port, self._incomplete_requests = port, list_incomplete_requests(key)
        self._selector = selectors.DefaultSelector()
        self._max_count, self.connected_count, self.closed_count, self.refused_count = number, 0, 0, 0

    def hang(self, seconds: float) -> None:
        """Keep the connections open for some seconds."""
        deadline_s = time.monotonic() + seconds
        while time.monotonic() < deadline_s:
            for _ in range(min(10, self._max_count - len(self._selector.get_map()))):
                self._connect()
            for key, _ in self._selector.select(0.05):
                self._read(key.fileobj)  # type: ignore[arg-type]

    def _connect(self) -> None:
        client = socket.socket()
        client.settimeout(0.2)
        try:
            client.connect(("127.0.0.1", self._port))
            client.send(self._incomplete_requests[self.connected_count % len(self._incomplete_requests)])
        except OSError:
            client.close()
            self.refused_count += 1
            return
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.connected_count += 1
        self._selector.register(client, selectors.EVENT_READ)

    def _read(self, client: socket.socket) -> None:
        """Read a few bytes: enough to see that the connection is closed, too few to read the answers."""
        data = b""
        with suppress(OSError):
            data = client.recv(16)
        if not data:
            self._selector.unregister(client)
            client.close()
            self.closed_count += 1


def request_status(state: Path, port: int, key: str, pipe: Connection) -> None:
    """Request the status until a message stops it; send the milliseconds of each answer, and the failures."""
    local_ms: list[float] = []
    request_count = failed_count = 0
    next_s = 0.0
    url, headers = f"http://127.0.0.1:{port}{NETWORK_PREFIX}/status", {"x-api-key": key}
    transport = httpx.HTTPTransport(uds=str(state / "farm.sock"))
    with httpx.Client(transport=transport, base_url="http://farm", timeout=TIMEOUT_S) as local_client:
        while not pipe.poll():
            start_s = time.perf_counter()
            local_client.get("/status").raise_for_status()
            local_ms.append(1000 * (time.perf_counter() - start_s))
            if time.monotonic() >= next_s:
                next_s, request_count = time.monotonic() + _NETWORK_PERIOD_S, request_count + 1
                try:
                    httpx.get(url, headers=headers, timeout=5.0).raise_for_status()
                except httpx.HTTPError:
                    failed_count += 1
            time.sleep(POLL_S)
    pipe.send((local_ms, request_count, failed_count))


def read_printer(farm: WebFarm) -> dict[str, Any]:
    """Read the printer's entry in `farm status --json`."""
    printer: dict[str, Any] = json.loads(farm.run("status", "--json"))["printers"][0]
    return printer


def measure(connection_count: int, seconds: float) -> dict[str, Any]:
    """Measure response times while connections hang, and then the time that the daemon takes to shut down."""
    with tempfile.TemporaryDirectory() as name:
        farm = WebFarm(Path(name))
        try:
            key = farm.add_key("bench", "print")
            model = Path(name) / "box.stl"
            trimesh.creation.box((20.0, 20.0, 5.0)).export(model)
            farm.run("submit", str(model), "--json")
            deadline_s = time.monotonic() + TIMEOUT_S
            while read_printer(farm)["print"] is None and time.monotonic() < deadline_s:
                time.sleep(0.5)
            printer_before = read_printer(farm)
            receiver, sender = multiprocessing.get_context("spawn").Pipe()
            requester = multiprocessing.get_context("spawn").Process(
                target=request_status, args=(farm.state, farm.port, key, sender)
            )
            clients = HangingClients(farm.port, key, connection_count)
            clients.hang(5.0)
            requester.start()
            clients.hang(seconds)
            descriptors = len(list(Path(f"/proc/{farm.pid}/fd").iterdir()))
            receiver.send(None)
            local_ms, request_count, failed_count = receiver.recv()
            requester.join()
            printer_after = read_printer(farm)
            start_s = time.monotonic()
            os.kill(farm.pid, signal.SIGTERM)
            while (farm.state / "farm.sock").exists() and time.monotonic() < start_s + TIMEOUT_S:
                clients.hang(0.1)
            shutdown_s = time.monotonic() - start_s
            uploads_left = [path.name for path in (farm.state / "work").glob("upload-*")]
        finally:
            farm.start()
            farm.run("down", "--now")
    local_ms.sort()
    return {
        "connections": connection_count,
        "connections_opened": clients.connected_count,
        "closed_by_the_daemon": clients.closed_count,
        "refused": clients.refused_count,
        "descriptors": descriptors,
        "status_requests": len(local_ms),
        "status_median_ms": local_ms[len(local_ms) // 2],
        "status_p99_ms": local_ms[int(0.99 * len(local_ms))],
        "status_worst_ms": local_ms[-1],
        "network_requests": request_count,
        "network_failures_share": failed_count / max(1, request_count),
        "new_agents": int(printer_before["agent_pid"] != printer_after["agent_pid"]),
        "printer_lost": int(printer_after["print"] is None),
        "shutdown_s": shutdown_s,
        "uploads_left": len(uploads_left),
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connections", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    _, descriptor_limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed_descriptors = args.connections + _SPARE_DESCRIPTORS
    resource.setrlimit(
        resource.RLIMIT_NOFILE,
        (
            needed_descriptors
            if descriptor_limit == resource.RLIM_INFINITY
            else min(needed_descriptors, descriptor_limit),
            descriptor_limit,
        ),
    )
    result = measure(args.connections, args.seconds)
    if args.json:
        print(json.dumps({**result, "goals": GOALS}, indent=2))
    else:
        print(
            f"{result['connections']} connections hang: the status on the Unix socket within "
            f"{result['status_median_ms']:.0f} ms, 99 % within {result['status_p99_ms']:.0f} ms, at worst "
            f"{result['status_worst_ms']:.0f} ms; on the network "
            f"{100 * result['network_failures_share']:.0f} % failed; "
            f"the daemon ended within {result['shutdown_s']:.1f} s of SIGTERM"
        )
    sys.exit(any(result[name] > limit for name, limit in GOALS.items()))


if __name__ == "__main__":
    main()
