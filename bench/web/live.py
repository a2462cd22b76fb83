"""CPU time of the Home page with many viewers of a large fleet, and the bytes that each of them receives.

``python -m bench.web.live [--printers N] [--viewers N] [--seconds S] [--json]``. A process serves the
pages of printers that all print; their temperatures and progress change every second. No agents run, so the
CPU time is that of the telemetry, the pages and their streams alone. The viewers are streams over
loopback, half of them with another role. The exit status is 1 if a goal is missed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import selectors
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from bench.fleets.agents.without_agents import NoEffects, make_snapshot
from bench.fleets.measured_daemon import PLATES_PER_JOB, fill_books
from drivers.clock import Clock
from farm.api import KeyRequest
from farm.compute import WorkerPool
from farm.config import Fleet, WebSection
from farm.control import Controller, DryRuns, KeyCommands
from farm.http import NetworkState, Services
from farm.model import Role
from farm.paths import StateFolder
from farm.planning import list_bed_boxes
from farm.planning.tasks import warm_up_planning
from farm.state.storage import open_books
from farm.web import NetworkServer, make_web_app

GOALS = {"core_share": 0.3}
_PRINTER_MODEL = "ultimaker2_plus"
_WARM_UP_S = 3.0


async def serve(folder: Path, printer_count: int, pipe: Connection) -> None:
    """Serve until a message ends the server; send the port and two keys, then the CPU seconds on request."""
    state = StateFolder(folder)
    state.make()
    names = [f"um2-{number:03d}" for number in range(1, printer_count + 1)]
    fill_books(state.books, names, 2 * PLATES_PER_JOB + 2 * printer_count)
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    web = {"listen": f"127.0.0.1:{port}"}
    rows = [{"name": name, "model": _PRINTER_MODEL, "port": f"sim://{_PRINTER_MODEL}"} for name in names]
    clock = Clock()
    store, restored_s = open_books(state, clock.now())
    controller = Controller(
        Fleet.model_validate({"web": web, "printers": rows}), store, clock, list_bed_boxes
    )
    controller.start(NoEffects(), restored_s)
    for name in names:
        controller.on_snapshot(make_snapshot(name))
    services = Services(
        controller,
        state,
        folder / "fleet.yaml",
        WorkerPool(state.work / "workers", 1, None, warm_up_planning),
        ignore_shutdown,
    )
    server = NetworkServer(
        WebSection.model_validate(web), make_web_app(services, DryRuns(controller), ()), 200, NetworkState()
    )
    server.start(lambda: True)
    keys = KeyCommands(controller)
    key_texts = [
        keys.add(KeyRequest(name=str(role), role=role), "bench").text for role in (Role.LOOK, Role.OPERATE)
    ]
    pipe.send((port, key_texts, len(list(controller.books.list_open_prints()))))
    progress_s = 0.0
    while True:
        if pipe.poll():
            if pipe.recv() is None:
                break
            pipe.send(time.process_time())
        progress_s += 1.0
        for attempt in list(controller.books.list_open_prints()):
            controller.on_snapshot(make_snapshot(attempt.printer, attempt, progress_s, 40_000.0))
        await asyncio.sleep(1.0)
    services.page_streams.close()
    await server.close()
    store.close()


async def ignore_shutdown(now: bool) -> None:
    """Ignore a request to shut down."""


def run_server(folder: Path, printer_count: int, pipe: Connection) -> None:
    """Run the server's process."""
    asyncio.run(serve(folder, printer_count, pipe))


class Server(NamedTuple):
    """Server in a process of its own: folder, port, the texts of two keys, and the number of prints."""

    folder: Path
    pipe: Connection
    port: int
    keys: list[str]
    print_count: int

    def read_cpu_s(self) -> float:
        """Return the CPU seconds of the process."""
        self.pipe.send("cpu")
        return float(self.pipe.recv())


@contextmanager
def start_server(printer_count: int) -> Iterator[Server]:
    """Serve the farm from a process of its own, and end it afterwards."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe()
    with tempfile.TemporaryDirectory() as name:
        process = context.Process(target=run_server, args=(Path(name), printer_count, sender))
        process.start()
        try:
            yield Server(Path(name), receiver, *receiver.recv())
        finally:
            receiver.send(None)
            process.join()


def receive_streams(port: int, keys: list[str], viewer_count: int, seconds: float) -> int:
    """Receive streams for some seconds; return the number of bytes."""
    received_bytes, selector = 0, selectors.DefaultSelector()
    for number in range(viewer_count):
        client = socket.create_connection(("127.0.0.1", port))
        head = f"GET /live HTTP/1.1\r\nHost: localhost\r\nX-Api-Key: {keys[number % len(keys)]}\r\n\r\n"
        client.sendall(head.encode())
        selector.register(client, selectors.EVENT_READ)
    deadline_s = time.monotonic() + seconds
    while time.monotonic() < deadline_s:
        for key, _ in selector.select(0.2):
            received_bytes += len(key.fileobj.recv(2**18))  # type: ignore[union-attr]
    for key in list(selector.get_map().values()):
        key.fileobj.close()  # type: ignore[union-attr]
    return received_bytes


def measure(printer_count: int, viewer_count: int, seconds: float) -> dict[str, Any]:
    """Measure the CPU of the server, without viewers and with them."""
    with start_server(printer_count) as server:
        time.sleep(_WARM_UP_S)
        start_cpu_s, start_s = server.read_cpu_s(), time.monotonic()
        time.sleep(seconds / 2)
        idle_core_share = (server.read_cpu_s() - start_cpu_s) / (time.monotonic() - start_s)
        start_cpu_s, start_s = server.read_cpu_s(), time.monotonic()
        received_bytes = receive_streams(server.port, server.keys, viewer_count, seconds)
        core_share = (server.read_cpu_s() - start_cpu_s) / (time.monotonic() - start_s)
    return {
        "printers": printer_count, "prints": server.print_count, "viewers": viewer_count,
        "core_share": core_share, "core_share_without_viewers": idle_core_share,
        "bytes_per_viewer_s": received_bytes / viewer_count / seconds,
        "load": os.getloadavg()[0],
    }  # fmt: skip


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=100)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = measure(args.printers, args.viewers, args.seconds)
    if args.json:
        print(json.dumps({**result, "goals": GOALS}, indent=2))
    else:
        print(
            f"{result['viewers']} viewers of {result['prints']} printing printers: "
            f"{100 * result['core_share']:.0f} % of a core, "
            f"{100 * result['core_share_without_viewers']:.0f} % without viewers; "
            f"{result['bytes_per_viewer_s'] / 1000:.0f} kB/s to each"
        )
    sys.exit(any(result[name] > limit for name, limit in GOALS.items()))


if __name__ == "__main__":
    main()
