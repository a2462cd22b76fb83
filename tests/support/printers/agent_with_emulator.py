"""A real agent with its emulator, and a client like that of the daemon."""

import asyncio
import hashlib
import os
import select
import subprocess
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control, read_status
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.emulator.status import EmulatorStatus
from drivers.remote import AgentClient, spawn_agent

PRINTER_MODEL = "ultimaker2_plus"
TIME_SCALE = 120.0
DEADLINE_S = 120.0

START_GCODE = """;FLAVOR:Marlin
G21
G90
M82
M107
M140 S40
G28
G1 F12000 X5 Y10
M190 S40
M109 S180
G1 F2400 Z20
G92 E0
G1 F47 E7.8
G92 E0
;LAYER:0
;TYPE:FILL
"""
END_GCODE = (
    ";TIME_ELAPSED:60\nG92 E0\nG1 F1500 E-6.5\nM104 S0\nM140 S0\nM107\nG91\nG1 F1500 E-13.5\nG90\nG28\nM84\n"
)


def make_gcode(moves: int) -> str:
    path = "".join(
        f"G1 F6000 X{50 + 100 * (i % 2)} Y{50 + i % 100} Z0.3 E{(i + 1) * 0.5:.2f}\n" for i in range(moves)
    )
    return START_GCODE + path + END_GCODE


class Printer:
    """An agent with its emulator, and a client that is connected to the agent."""

    def __init__(self, folder: Path, url: str) -> None:
        self.folder, self.url = folder, url
        self.power_off_cmd: str | None = None
        self.clock = Clock(TIME_SCALE, time.time())
        self.process: subprocess.Popen[bytes] | None = None
        self.client = AgentClient(folder)
        self.last_snapshot: m.Snapshot | None = None
        self._unseen_snapshots: deque[m.Snapshot] = deque()  # since the last wait, or since `start`
        self._follow_task: asyncio.Task[None] | None = None

    def spawn(self) -> None:
        self.process = spawn_agent(
            "um2-01", PRINTER_MODEL, self.url, self.folder, self.clock, self.power_off_cmd
        )

    async def connect(self) -> None:
        self.last_snapshot = None
        self._unseen_snapshots.clear()
        await self.client.connect()
        self._follow_task = asyncio.create_task(self._follow())

    async def _follow(self) -> None:
        async for snapshot in self.client.receive_snapshots():
            self.last_snapshot = snapshot
            self._unseen_snapshots.append(snapshot)

    async def wait_for(self, condition: Callable[[m.Snapshot], bool]) -> m.Snapshot:
        """Wait for a snapshot that meets a condition, even if others have followed it on a busy computer."""
        async with asyncio.timeout(DEADLINE_S):
            while True:
                while self._unseen_snapshots:
                    snapshot = self._unseen_snapshots.popleft()
                    if condition(snapshot):
                        return snapshot
                if self.last_snapshot is not None and condition(self.last_snapshot):
                    return self.last_snapshot
                await asyncio.sleep(0.01)

    async def wait_until_ready(self) -> m.Snapshot:
        return await self.wait_for(lambda s: s.link is m.LinkState.READY)

    async def wait_for_phase(self, phase: m.PrintPhase) -> m.PrintSnapshot:
        snapshot = await self.wait_for(lambda s: s.print is not None and s.print.phase is phase)
        assert snapshot.print is not None
        return snapshot.print

    async def start(self, text: str, print_id: str = "p-1", sha256: str | None = None) -> m.Reply:
        path = self.folder.parent / f"{print_id}.gcode"
        path.write_text(text)
        digest = sha256 or hashlib.sha256(text.encode()).hexdigest()
        request = m.StartPrint(
            id=0,
            print_id=print_id,
            gcode=str(path),
            sha256=digest,
            print_time_s=60.0,
            filament=m.Filament.PARKED,
        )
        self._unseen_snapshots.clear()
        return await self.client.request(request)

    def read_targets(self) -> tuple[float, float]:
        status = read_status(self.folder / "emulator")
        return status.nozzle_target_c, status.bed_target_c

    async def close(self) -> None:
        await self.client.close()
        if self._follow_task is not None:
            await self._follow_task
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
        if self.process is not None:
            self.process.wait(10.0)
        if emulator_is_running(self.folder / "emulator"):
            control(self.folder / "emulator", "power_off")


@asynccontextmanager
async def run_printer(
    folder: Path, faults: str = "", time_scale: float = TIME_SCALE
) -> AsyncIterator[Printer]:
    """Run an agent with its emulator; yield it when it is ready."""
    printer = Printer(folder / "agent", f"sim://{PRINTER_MODEL}{faults}")
    printer.clock = Clock(time_scale, time.time())
    printer.spawn()
    try:
        await printer.connect()
        await printer.wait_until_ready()
        yield printer
    finally:
        await printer.close()


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(scenario)


def wait_for_emulator(folder: Path, condition: Callable[[EmulatorStatus], bool]) -> bool:
    """Wait until the state of an emulator meets a condition; return False at the deadline."""
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition(read_status(folder)) and time.monotonic() < deadline_s:
        select.select([], [], [], 0.02)
    return condition(read_status(folder))


def read_buffered_bytes(master: int) -> bytes:
    """Read all bytes that are buffered for a board."""
    os.set_blocking(master, False)
    result = b""
    with suppress(BlockingIOError):
        while data := os.read(master, 4096):
            result += data
    return result
