"""CPU, memory and turnaround of agents whose printers only acknowledge lines.

``python -m bench.printing.agent [--agents N] [--lines N] [--rate LINES_PER_S] [--megabytes MB] [--json]``.
Real agents run on real pseudo-terminals in wall time; the boards, all in this process, send at most `rate`
oks per second. Turnaround is the time from writing an ok to reading the next line, with this process and the
kernel included. CPU and memory are the kernel's figures for each agent while it streams.
"""

from __future__ import annotations

import argparse
import asyncio
import heapq
import json
import select
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

from bench.printing.followed_print import follow_print, make_start_request
from bench.process_use import read_cpu_s, read_memory_mb
from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.firmware import wording
from drivers.emulator.firmware.dialects import ultimaker2
from drivers.emulator.firmware.planner import Limits
from drivers.emulator.port import Port
from drivers.errors import DriverError
from drivers.printers import PROFILES
from drivers.remote import AgentClient, spawn_agent

PRINTER_MODEL = "ultimaker2_plus"
START_GCODE = "G21\nG90\nM82\nM107\nG28\nM109 S180\nG1 F2400 Z20\nG92 E0\n"
BOOT_S = 0.3  # the board ignores received bytes during this time
END_GCODE = "M104 S0\nM140 S0\nG28\nM84\n"
POSITION_ANSWER = b"X:0.00Y:224.50Z:215.00E:0.00 Count X: 0.00Y:224.50Z:215.00\n"


class FakeBoard:
    """Board that acknowledges lines, and reaches every target temperature at once."""

    def __init__(self, link: Path, period_s: float) -> None:
        profile = PROFILES[PRINTER_MODEL]
        self.port = Port(link)
        self.turnarounds_s: list[float] = []
        self._banner = wording.START + ultimaker2.format_banner(profile, Limits.from_profile(profile))
        self._period_s = period_s
        self._partial = b""
        self._nozzle_c = self._bed_c = b"0"
        self._next_ok_s = self._ok_sent_s = self.boot_end_s = 0.0

    def reset(self) -> None:
        """Reset, as when the host opens the port."""
        self.port.discard_bytes()
        self._partial, self._nozzle_c, self._bed_c = b"", b"0", b"0"
        self.boot_end_s = time.monotonic() + BOOT_S

    def receive(self, now_s: float) -> float | None:
        """Process received bytes; return the time at which the ok to a move is due, or None."""
        data = self.port.read()
        if self.boot_end_s:
            return None
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in lines:
            command = line.partition(b" ")[2].partition(b"*")[0] if line.startswith(b"N") else line
            if command.startswith(b"G1 X"):
                if self._ok_sent_s:
                    self.turnarounds_s.append(now_s - self._ok_sent_s)
                self._next_ok_s = max(now_s, self._next_ok_s + self._period_s)
                return self._next_ok_s
            self._ok_sent_s = 0.0
            self._answer(command)
        return None

    def _answer(self, command: bytes) -> None:
        name, _, value = command.partition(b" S")
        if name == b"M104":
            self._nozzle_c = value
        elif name == b"M140":
            self._bed_c = value
        elif name == b"M105":
            nozzle_c, bed_c = (max(float(c), 21.0) for c in (self._nozzle_c, self._bed_c))
            temperatures = (nozzle_c, self._nozzle_c, bed_c, self._bed_c)
            self.port.write(b"ok T:%.1f /%b.0 B:%.1f /%b.0 @:0 B@:0\n" % temperatures)
            return
        answers = {b"M115": ultimaker2.IDENTITY, b"M114": POSITION_ANSWER, b"M27": b"Not SD printing\n"}
        self.port.write(answers.get(name, b"") + wording.OK)

    def send_due(self) -> None:
        """Send the answer that is due: the banner after a reset, else an ok."""
        has_booted, self.boot_end_s = self.boot_end_s, 0.0
        self.port.write(self._banner if has_booted else wording.OK)
        self._ok_sent_s = 0.0 if has_booted else time.monotonic()


class FakeBoards(threading.Thread):
    """Thread that serves all boards with one `epoll` object."""

    def __init__(self, boards: list[FakeBoard]) -> None:
        super().__init__(daemon=True)
        self._boards = boards
        self.is_stopped = False

    def run(self) -> None:
        """Serve the boards until `is_stopped` is set."""
        poll = select.epoll()
        deadlines: list[tuple[float, int, FakeBoard]] = []
        for board in self._boards:
            poll.register(board.port.watch_fd, select.EPOLLIN)
        boards_by_watch_fd = {board.port.watch_fd: board for board in self._boards}
        boards_by_master_fd = {board.port.master_fd: board for board in self._boards}
        open_ports: set[int] = set()
        while not self.is_stopped:
            wait_s = max(0.0, deadlines[0][0] - time.monotonic()) if deadlines else 0.1
            events = poll.poll(wait_s)
            now_s = time.monotonic()
            while deadlines and deadlines[0][0] <= now_s:
                heapq.heappop(deadlines)[2].send_due()
            for fd, _ in events:
                if fd in boards_by_watch_fd:
                    board = boards_by_watch_fd[fd]
                    if board.port.process_port_events():
                        board.reset()
                        deadlines = [entry for entry in deadlines if entry[2] is not board]
                        heapq.heapify(deadlines)
                        heapq.heappush(deadlines, (board.boot_end_s, fd, board))
                    master = board.port.master_fd
                    if board.port.is_open != (master in open_ports):
                        if board.port.is_open:
                            poll.register(master, select.EPOLLIN)
                            open_ports.add(master)
                        else:
                            poll.unregister(master)
                            open_ports.discard(master)
                elif fd in open_ports:
                    due_s = boards_by_master_fd[fd].receive(now_s)
                    if due_s is not None:
                        heapq.heappush(deadlines, (due_s, fd, boards_by_master_fd[fd]))


def _is_running(process: subprocess.Popen[bytes]) -> bool:
    """Wait for at most 60 s until a process ends; return whether it still runs."""
    try:
        process.wait(60.0)
    except subprocess.TimeoutExpired:
        return True
    return False


async def print_file(folder: Path, port: Path, gcode: Path, max_lines: int | None) -> dict[str, float]:
    """Print on one printer, to the end or for `max_lines`; measure CPU share and memory of its agent."""
    process = spawn_agent(folder.name, PRINTER_MODEL, str(port), folder, Clock())
    client = AgentClient(folder)
    request = make_start_request(gcode, filament=m.Filament.AT_NOZZLE)
    first_line: tuple[float, float] | None = None
    memory_mb, cpu_share = 0.0, 0.0
    try:
        await client.connect(timeout_s=60.0)
        async for snapshot in follow_print(client, request, clears_bed=True):
            if snapshot.phase is m.PrintPhase.PRINTING:
                cpu_s = read_cpu_s(process.pid)
                memory_mb = max(memory_mb, read_memory_mb(process.pid))
                first_line = first_line or (time.monotonic(), cpu_s)
                if time.monotonic() > first_line[0]:
                    cpu_share = (cpu_s - first_line[1]) / (time.monotonic() - first_line[0])
                if max_lines is not None and snapshot.line > max_lines:
                    break
    finally:
        with suppress(DriverError):
            await client.request(m.Shutdown(id=0, now=True))
        await client.close()
        if await asyncio.to_thread(_is_running, process):
            process.kill()
    return {"cpu_share": cpu_share, "memory_mb": memory_mb}


def write_gcode(lines: int, megabytes: int) -> bytes:
    """Write G-code with at least this number of moves, in layers and features, and at least this size."""
    chunks = [START_GCODE, "G0 F9000 X100 Y100 Z0.3\n"]
    size = i = 0
    while i < lines or size < megabytes * 1_000_000:
        chunk = f"G1 X{100 + i % 2 * 0.2:.3f} Y{100 + i % 7 * 0.1:.3f} E{i * 0.01:.5f}\n"
        if not i % 1200:
            chunk += f";LAYER:{i // 1200}\n"
        if not i % 12:
            chunk += f";TYPE:{('WALL-INNER', 'FILL')[i // 12 % 2]}\n"
        chunks.append(chunk)
        size += len(chunk)
        i += 1
    return "".join((*chunks, END_GCODE)).encode()


async def measure(agents: int, lines: int, rate: float, megabytes: int = 0) -> dict[str, float]:
    """Print on all agents at the same time; only the first `lines` moves of a large file are printed."""
    text = write_gcode(lines, megabytes)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        gcode = folder / "bench.gcode"
        gcode.write_bytes(text)
        boards = [FakeBoard(folder / f"tty{number}", 1.0 / rate) for number in range(agents)]
        board_thread = FakeBoards(boards)
        board_thread.start()
        results = await asyncio.gather(
            *(
                print_file(
                    folder / f"p{number}",
                    folder / f"tty{number}",
                    gcode,
                    lines if megabytes else None,
                )
                for number in range(agents)
            ),
            return_exceptions=True,  # all agents end before a failure is reported
        )
        board_thread.is_stopped = True
        board_thread.join()
    if errors := [run for run in results if isinstance(run, BaseException)]:
        raise SystemExit(str(errors[0]))
    runs = [run for run in results if not isinstance(run, BaseException)]
    turnarounds_s = sorted(value for board in boards for value in board.turnarounds_s)
    return {
        "agents": agents,
        "lines_per_s_each": rate,
        "turnarounds": len(turnarounds_s),
        "turnaround_median_ms": round(1e3 * turnarounds_s[len(turnarounds_s) // 2], 3),
        "turnaround_p99_ms": round(1e3 * turnarounds_s[int(len(turnarounds_s) * 0.99)], 3),
        "cpu_percent_of_a_core": round(100 * max(run["cpu_share"] for run in runs), 2),
        "memory_mb": round(max(run["memory_mb"] for run in runs), 1),
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=8)
    parser.add_argument("--lines", type=int, default=1000, help="lines of each agent")
    parser.add_argument("--rate", type=float, default=50.0, help="lines per second of each agent")
    parser.add_argument(
        "--megabytes", type=int, default=0, help="size of the file; only --lines of it are printed"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = asyncio.run(measure(options.agents, options.lines, options.rate, options.megabytes))
    print(
        json.dumps({"schema": 1, **result})
        if options.json
        else "\n".join(f"{k}: {v}" for k, v in result.items())
    )


if __name__ == "__main__":
    main()
