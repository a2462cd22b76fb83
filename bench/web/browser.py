"""Home of a large fleet in Chromium: stalls of its main thread, first paint, and the size of pages.

``PYTHONPATH=tests/support python -m bench.web.browser [--printers N] [--seconds S] [--json]``. The farm is
that of `bench.web.live`: all printers print, and their temperatures change every second. A stall is a
task of the page's main thread, measured by its CPU time, which other work on the machine does not lengthen,
and by its wall time. The goal applies to the quickest of the first paints, because other work only lengthens
them. A phone is simulated by a processor that is four times slower, and by slow 4G as Lighthouse defines it:
150 ms and 1.6 Mbit/s. The exit status is 1 if a goal is missed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.web.live import start_server
from browser.chromium import CHROMIUM, Chromium  # type: ignore[import-not-found]  # in tests/support
from farm.web.pages.static_files import load_static_files

GOALS = {"stall_ms": 50.0, "paint_ms": 300.0, "phone_paint_ms": 1000.0, "home_kb": 60.0, "viewer_kb": 250.0}
_LOAD_COUNT = 12
_SLOW_4G = {"latency": 150, "downloadThroughput": 1.6e6 / 8, "uploadThroughput": 0.75e6 / 8}
_UNLIMITED_NETWORK = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
_PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? 0"
_WEIGHT = """performance.getEntries().reduce((sum, one) => sum + (one.transferSize ?? 0), 0)"""


class Tracer:
    """Tracer of the tasks of a tab's main thread."""

    def __init__(self, tab: Any) -> None:
        self._tab, self._events = tab, list[dict[str, Any]]()
        self._complete, self._on_event = asyncio.Event(), tab.on_event
        tab.on_event = self._collect

    def _collect(self, method: str, params: dict[str, Any]) -> None:
        if method == "Tracing.dataCollected":
            self._events += params["value"]
        elif method == "Tracing.tracingComplete":
            self._complete.set()
        self._on_event(method, params)

    async def trace(self, seconds: float) -> list[tuple[float, float]]:
        """Return the CPU and wall milliseconds of each task during some seconds."""
        categories = "disabled-by-default-devtools.timeline,__metadata"
        await self._tab.call("Tracing.start", categories=categories, transferMode="ReportEvents")
        await asyncio.sleep(seconds)
        await self._tab.call("Tracing.end")
        await self._complete.wait()
        names = [event for event in self._events if event["name"] == "thread_name"]
        main_threads = {
            (event["pid"], event["tid"]) for event in names if event["args"]["name"] == "CrRendererMain"
        }
        return [
            (event.get("tdur", event["dur"]) / 1000, event["dur"] / 1000)
            for event in self._events
            if event["name"] == "RunTask" and "dur" in event and (event["pid"], event["tid"]) in main_threads
        ]


async def load_page(
    tab: Any, address: str, slowdown: int, network: Mapping[str, float]
) -> tuple[list[float], float]:
    """Load a page several times without a cache; return sorted first paints in ms, and the size in kB."""
    await tab.call("Network.setCacheDisabled", cacheDisabled=True)
    await tab.call("Emulation.setCPUThrottlingRate", rate=slowdown)
    await tab.call("Network.emulateNetworkConditions", offline=False, **network)
    paints = []
    for _ in range(_LOAD_COUNT):
        await tab.open(address)
        await tab.wait_for(f"{_PAINT} > 0")
        paints.append(float(await tab.evaluate(_PAINT)))
    return sorted(paints), float(await tab.evaluate(_WEIGHT)) / 1000


async def measure_home(port: int, key: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Measure Home in a browser."""
    home = f"http://127.0.0.1:{port}/"
    async with Chromium(folder, "") as tab:
        await tab.call("Network.setExtraHTTPHeaders", headers={"X-Api-Key": key})
        paints_ms, home_kb = await load_page(tab, home, 1, _UNLIMITED_NETWORK)
        phone_paints_ms, _ = await load_page(tab, home, 4, _SLOW_4G)
        await load_page(tab, home, 1, _UNLIMITED_NETWORK)
        tasks = await Tracer(tab).trace(seconds)
    viewer = load_static_files().get("viewer.js")
    return {
        "tasks": len(tasks), "stall_ms": max(task for task, _ in tasks),
        "stall_wall_ms": max(task for _, task in tasks),
        "paint_ms": paints_ms[0], "median_paint_ms": statistics.median(paints_ms),
        "phone_paint_ms": phone_paints_ms[0], "median_phone_paint_ms": statistics.median(phone_paints_ms),
        "home_kb": home_kb,
        "viewer_kb": None if viewer is None else home_kb + len(viewer.compressed_content) / 1000,
    }  # fmt: skip


def measure(printers: int, seconds: float) -> dict[str, Any]:
    """Serve the farm from a process of its own, and measure Home."""
    with start_server(printers) as server:
        result = asyncio.run(measure_home(server.port, server.keys[1], seconds, server.folder / "profile"))
    return {"prints": server.print_count, **result, "load": os.getloadavg()[0]}


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if CHROMIUM is None:
        sys.exit("this needs a browser: apt-get install chromium")
    result = measure(args.printers, args.seconds)
    if args.json:
        print(json.dumps({**result, "goals": GOALS}, indent=2))
    else:
        for name, value in result.items():
            print(f"{name}: {value}" + (f" (goal: {GOALS[name]:g})" if name in GOALS else ""))
    sys.exit(any((result[name] or 0.0) > limit for name, limit in GOALS.items()))


if __name__ == "__main__":
    main()
