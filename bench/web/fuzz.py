"""Random requests to a real daemon: none may fail, memory must not grow, no caller may exceed its role.

``python -m bench.web.fuzz [--requests N] [--seed N] [--at-once N] [--json]``. The daemon has two simulated
printers and a server for the network. Three quarters of the requests come from callers who may change
nothing: without a key, with a wrong or a revoked one, or with the role `look`. The other callers have the
roles `print` and `operate`. Every request has its own connection. The exit status is 1 if a goal is missed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from bench.process_use import read_memory_mb
from bench.web.farm import WebFarm
from bench.web.requests import FuzzedRequest, list_statuses, make_request
from farm.http.stream_limit import STREAM_TYPE

ANSWER_TIMEOUT_S = 600.0  # a model waits for the start of the workers, and for the planning of earlier models
DAMAGED_TIMEOUT_S = 0.05
"""Time to wait for the answer to a request that a server need not answer."""
WARM_UP_REQUESTS = 5000
"""Requests after which the daemon has loaded all code, and memory is measured."""
GOALS = {
    "failed": 0, "unanswered": 0, "events_without_permission": 0, "jobs_without_permission": 0,
    "prints_without_permission": 0,
    "uploads_left": 0, "new_descriptors": 4, "memory_growth_mb_per_100000": 20.0,
}  # fmt: skip
_SILENT_CAMERA_STATUS = 503
_MAX_SHOWN = 20


class FuzzedFarm(WebFarm):
    """Daemon with keys for callers of every kind."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, ("a", "b"))
        roles = {"look": "look", "print": "print", "operate": "operate", "revoked": "operate"}
        self.keys = {name: self.add_key(name, role) for name, role in roles.items()}
        self.run("key", "revoke", self.keys["revoked"].split("_")[1])
        self.keys |= {"nobody": "", "wrong": "farm_wrong_key"}

    def measure(self) -> dict[str, float]:
        """Measure memory, descriptors, files of uploads, and rows of the database."""
        process = Path(f"/proc/{self.pid}")
        with closing(sqlite3.connect(f"file:{self.state / 'farm.db'}?mode=ro", uri=True)) as books:
            rows = {
                table: books.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
                for table in ("event", "job", "print")
            }
        return {
            "resident_mb": read_memory_mb(self.pid),
            "descriptors": len(list((process / "fd").iterdir())),
            "uploads": len(list((self.state / "work").glob("upload-*"))),
            **rows,
        }


async def send(port: int, request: FuzzedRequest, answer_s: float = ANSWER_TIMEOUT_S) -> list[int]:
    """Send a request on its own connection; return the statuses of the answers."""
    answer, timeout_s = b"", answer_s if request.intact else DAMAGED_TIMEOUT_S
    with suppress(ConnectionError, TimeoutError):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            writer.write(request.data)
            while chunk := await asyncio.wait_for(reader.read(65536), timeout_s):
                answer += chunk
                if STREAM_TYPE.encode() in answer:
                    break  # a stream does not end
        finally:
            writer.close()
    return list(list_statuses(answer))


class RequestSender:
    """Sender of several parallel requests, which counts the answers."""

    def __init__(self, port: int, rng: random.Random, connections: int) -> None:
        self._port, self._rng, self._connections = port, rng, connections
        self.statuses: Counter[int] = Counter()
        self.failures: list[tuple[list[int], bytes]] = []
        self.sent = self.intact = self.unanswered = self.accepted = 0

    async def run(self, number: int, keys: Mapping[str, str]) -> None:
        """Send a number of requests from callers with these keys."""
        remaining = number

        async def send_requests() -> None:
            nonlocal remaining
            while remaining > 0:
                remaining -= 1
                request = make_request(self._rng, keys)
                self._count(request, await send(self._port, request))

        await asyncio.gather(*(send_requests() for _ in range(self._connections)))

    def _count(self, request: FuzzedRequest, statuses: list[int]) -> None:
        self.sent += 1
        self.intact += request.intact
        self.statuses.update(statuses)
        if request.method != "GET":
            self.accepted += sum(200 <= status < 300 for status in statuses)
        if request.intact and not statuses:
            self.unanswered += 1
            self.failures.append((statuses, request.data))
        if any(status >= 500 and status != _SILENT_CAMERA_STATUS for status in statuses):
            self.failures.append((statuses, request.data))


def measure(request_count: int, seed: int, connections: int) -> dict[str, Any]:
    """Send the requests, and compare the daemon before and after."""
    with tempfile.TemporaryDirectory() as name:
        farm = FuzzedFarm(Path(name))
        try:
            sender, start_s = RequestSender(farm.port, random.Random(seed), connections), time.monotonic()
            read_only_keys = {name: farm.keys[name] for name in ("nobody", "wrong", "revoked", "look")}
            writing_keys = {name: farm.keys[name] for name in ("print", "operate")}
            measures_before = farm.measure()
            warm_up = min(WARM_UP_REQUESTS, request_count // 4)
            asyncio.run(sender.run(warm_up, read_only_keys))
            measures_after_warm_up = farm.measure()
            asyncio.run(sender.run(request_count * 3 // 4 - warm_up, read_only_keys))
            measures_read_only = farm.measure()
            accepted_read_only = sender.accepted
            asyncio.run(sender.run(request_count - request_count * 3 // 4, writing_keys))
            measures_after = farm.measure()
            deadline_s = time.monotonic() + ANSWER_TIMEOUT_S
            while measures_after["uploads"] and time.monotonic() < deadline_s:
                time.sleep(1.0)  # a complete upload is inspected even if its sender has disconnected
                measures_after = farm.measure()
            status = json.loads(farm.run("status", "--json"))
        finally:
            farm.run("down", "--now")
    count = max(1, request_count * 3 // 4 - warm_up)
    failed_count = sum(bool(statuses) for statuses, _ in sender.failures)
    return {
        "requests": sender.sent,
        "intact": sender.intact,
        "seconds": time.monotonic() - start_s,
        "statuses": dict(sorted(sender.statuses.items())),
        "failed": failed_count,
        "unanswered": sender.unanswered,
        "failures": [(statuses, repr(data[:2000])) for statuses, data in sender.failures[:_MAX_SHOWN]],
        "events_without_permission": measures_read_only["event"] - measures_before["event"],
        "jobs_without_permission": measures_read_only["job"],
        "prints_without_permission": measures_read_only["print"],
        "accepted_changes": sender.accepted - accepted_read_only,
        "new_events": measures_after["event"] - measures_read_only["event"],
        "new_jobs": measures_after["job"],
        "new_prints": measures_after["print"],
        "uploads_left": measures_after["uploads"],
        "new_descriptors": measures_read_only["descriptors"] - measures_after_warm_up["descriptors"],
        "memory_growth_mb_per_100000": (
            measures_read_only["resident_mb"] - measures_after_warm_up["resident_mb"]
        )
        * 100_000
        / count,
        "resident_mb": [
            sample["resident_mb"]
            for sample in (measures_before, measures_after_warm_up, measures_read_only, measures_after)
        ],
        "printers": {printer["name"]: printer["state"] for printer in status["printers"]},
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--requests", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-once", type=int, default=8)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = measure(args.requests, args.seed, args.at_once)
    if args.json:
        print(json.dumps({**result, "goals": GOALS}, indent=2))
    else:
        print(
            f"{result['requests']} requests in {result['seconds']:.0f} s: {result['failed']} failed, "
            f"{result['unanswered']} unanswered; {result['events_without_permission']} events and "
            f"{result['prints_without_permission']} prints by callers without permission; "
            f"memory grows by {result['memory_growth_mb_per_100000']:.1f} MB for 100,000 requests"
        )
        for statuses, data in result["failures"]:
            print(statuses, data[:500])
    sys.exit(any(result[name] > limit for name, limit in GOALS.items()))


if __name__ == "__main__":
    main()
