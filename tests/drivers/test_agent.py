"""Real processes: an agent, the emulator on a pty, and a client as the daemon has it."""

import asyncio
import hashlib
import os
import pty
import select
import signal
import stat
import subprocess
import threading
import time
import tty
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from drivers import messages as m
from drivers.agent.journal import Journal
from drivers.agent.loop import Agent
from drivers.agent.spool import Spool
from drivers.client import AgentClient, alive, spawn
from drivers.clock import Clock
from drivers.emulator.launch import alive as emulator_alive
from drivers.emulator.launch import control, launch, read_status
from drivers.emulator.status import EmulatorStatus
from drivers.errors import AgentError, BadGcode, JournalError
from drivers.profiles import PROFILES

MODEL = "ultimaker2_plus"
SCALE = 120.0
DEADLINE_S = 30.0

HEAD = """;FLAVOR:Marlin
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
TAIL = (
    ";TIME_ELAPSED:60\nG92 E0\nG1 F1500 E-6.5\nM104 S0\nM140 S0\nM107\nG91\nG1 F1500 E-13.5\nG90\nG28\nM84\n"
)


def gcode(moves: int) -> str:
    path = "".join(
        f"G1 F6000 X{50 + 100 * (i % 2)} Y{50 + i % 100} Z0.3 E{(i + 1) * 0.5:.2f}\n" for i in range(moves)
    )
    return HEAD + path + TAIL


class Printer:
    """One agent with its emulator, and a client."""

    def __init__(self, folder: Path, url: str) -> None:
        self.folder, self.url = folder, url
        self.power_off_cmd: str | None = None
        self.clock = Clock(SCALE, time.time())
        self.process: subprocess.Popen[bytes] | None = None
        self.client = AgentClient(folder)
        self.last: m.Snapshot | None = None
        self._following: asyncio.Task[None] | None = None

    def spawn(self) -> None:
        self.process = spawn("um2-01", MODEL, self.url, self.folder, self.clock, self.power_off_cmd)

    async def connect(self) -> None:
        self.last = None
        await self.client.connect()
        self._following = asyncio.create_task(self._follow())

    async def _follow(self) -> None:
        async for snapshot in self.client.snapshots():
            self.last = snapshot

    async def until(self, seen: Callable[[m.Snapshot], bool]) -> m.Snapshot:
        async with asyncio.timeout(DEADLINE_S):
            while self.last is None or not seen(self.last):
                await asyncio.sleep(0.01)
            return self.last

    async def ready(self) -> m.Snapshot:
        return await self.until(lambda s: s.link is m.LinkState.READY)

    async def phase(self, phase: m.PrintPhase) -> m.PrintSnapshot:
        snapshot = await self.until(lambda s: s.print is not None and s.print.phase is phase)
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
        return await self.client.request(request)

    def targets(self) -> tuple[float, float]:
        status = read_status(self.folder / "emulator")
        return status.nozzle_target_c, status.bed_target_c

    async def close(self) -> None:
        await self.client.close()
        if self._following is not None:
            await self._following
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
        if self.process is not None:
            self.process.wait(10.0)
        if emulator_alive(self.folder / "emulator"):
            control(self.folder / "emulator", "power_off")


@asynccontextmanager
async def printer(folder: Path, faults: str = "") -> AsyncIterator[Printer]:
    one = Printer(folder / "agent", f"sim://{MODEL}{faults}")
    one.spawn()
    try:
        await one.connect()
        await one.ready()
        yield one
    finally:
        await one.close()


def run(story: Coroutine[Any, Any, None]) -> None:
    asyncio.run(story)


@pytest.mark.system
def test_a_print_is_printed_once_and_the_bed_is_not_clear_after_it(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            assert one.last is not None
            assert (one.last.bed_clear, one.last.filament) == (True, m.Filament.PARKED)
            text = gcode(200)
            assert (await one.start(text)).error is None
            assert (await one.start(text)).error is None  # told again: nothing changes
            done = await one.phase(m.PrintPhase.DONE)
            assert (done.line, done.progress_s, done.fault) == (done.lines, 60.0, None)
            assert (done.layer, done.layers, done.feature) == (1, 1, "FILL")
            assert done.extruded and done.started_s is not None and done.ended_s is not None
            last = await one.until(lambda s: s.bed_clear is False)
            assert last.heaters_off and last.filament is m.Filament.PARKED
            assert one.targets() == (0.0, 0.0)
            moves = read_status(one.folder / "emulator").moves
            assert (await one.start(text)).error is None  # ended: never printed twice
            assert (await one.client.request(m.ForgetPrint(id=0, print_id="p-1"))).error is None
            await one.until(lambda s: s.print is None)
            assert (await one.client.request(m.BedCleared(id=0))).error is None
            await one.until(lambda s: s.bed_clear is True)
            assert read_status(one.folder / "emulator").moves == moves
            assert (await one.client.request(m.Shutdown(id=0))).error is None
            assert one.process is not None
            assert await asyncio.to_thread(one.process.wait, 10.0) == 0
            assert not alive(one.folder)

    run(story())


@pytest.mark.system
def test_when_an_agent_is_killed_the_next_one_shows_heaters_off_and_fails_the_print(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(gcode(50_000))
            await one.phase(m.PrintPhase.PRINTING)
            assert one.process is not None
            one.process.kill()
            one.process.wait(10.0)
            assert not alive(one.folder)
            assert one.targets() != (0.0, 0.0)  # closing the port switches nothing off
            one.spawn()
            await one.connect()
            failed = await one.phase(m.PrintPhase.FAILED)
            assert failed.fault == "agent_died"
            assert failed.extruded
            last = await one.ready()
            assert last.heaters_off
            assert one.targets() == (0.0, 0.0)

    run(story())


@pytest.mark.system
def test_a_print_goes_on_without_a_daemon_and_a_signal_ends_the_agent_after_it(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(gcode(3000))
            first = await one.phase(m.PrintPhase.PRINTING)
            await one.client.close()
            assert one.process is not None
            one.process.send_signal(signal.SIGTERM)
            await one.connect()
            last = await one.until(lambda s: s.print is not None and s.print.line > first.line)
            assert last.agent_pid == one.process.pid
            refused = await one.client.request(m.Shutdown(id=0))
            assert refused.error is not None and "now" in refused.error
            await one.client.request(m.CancelPrint(id=0, print_id="another"))
            assert (await one.client.request(m.Hello(id=0))).snapshot.link is m.LinkState.BUSY  # type: ignore[union-attr]
            await one.client.request(m.CancelPrint(id=0, print_id="p-1", reason="enough"))
            cancelled = await one.phase(m.PrintPhase.CANCELLED)
            assert cancelled.reason == "enough"
            assert cancelled.ended_s is not None
            assert await asyncio.to_thread(one.process.wait, 10.0) == 0  # as the signal asked
            assert one.targets() == (0.0, 0.0)
            one.spawn()
            await one.connect()
            last = await one.until(lambda s: s.heaters_off)
            assert last.filament is m.Filament.PARKED
            one.process.send_signal(signal.SIGTERM)  # idle now
            assert await asyncio.to_thread(one.process.wait, 10.0) == 0

    run(story())


@pytest.mark.system
def test_an_interrupt_ends_the_print_safely_and_then_the_agent(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(gcode(50_000))
            await one.phase(m.PrintPhase.PRINTING)
            assert one.process is not None
            one.process.send_signal(signal.SIGINT)
            await one.phase(m.PrintPhase.CANCELLED)
            assert await asyncio.to_thread(one.process.wait, 10.0) == 0
            assert one.targets() == (0.0, 0.0)

    run(story())


@pytest.mark.system
@pytest.mark.parametrize("lines", [40, 77, 114])
def test_after_a_cancel_in_the_middle_the_filament_is_parked_whatever_was_drawn_back(
    tmp_path: Path, lines: int
):
    strokes = (
        f"G1 F1500 X{50 + 9 * (i % 2)} Y{50 + i % 100} Z0.3 E{i + 1}\nG1 F900 E{i - 5.5}\n"
        f"G0 F9000 X{80 - 9 * (i % 2)}\nG1 F900 E{i + 1}\n"
        for i in range(2000)
    )

    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(HEAD.replace("S180", "S210") + "".join(strokes) + TAIL)
            await one.until(lambda s: s.print is not None and s.print.line >= lines)
            await one.client.request(m.CancelPrint(id=0, print_id="p-1"))
            await one.phase(m.PrintPhase.CANCELLED)
            last = await one.ready()
            assert last.heaters_off and last.filament is m.Filament.PARKED
            assert settled(one.folder / "emulator", lambda s: abs(s.filament_end_mm + 20.0) <= 0.5)

    run(story())


@pytest.mark.system
def test_a_print_is_paused_and_goes_on(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(gcode(1500))
            await one.until(lambda s: s.print is not None and s.print.line >= 100)
            await one.client.request(m.PausePrint(id=0, print_id="p-1"))
            paused = await one.phase(m.PrintPhase.PAUSED)
            await one.until(lambda s: s.filament is m.Filament.PARKED)
            assert await asyncio.to_thread(settled, one.folder / "emulator", lambda s: s.nozzle_target_c == 0)
            assert one.targets() == (0.0, 40.0)
            await one.client.request(m.ResumePrint(id=0, print_id="p-1"))
            done = await one.phase(m.PrintPhase.DONE)
            assert done.line == done.lines > paused.line
            assert one.targets() == (0.0, 0.0)

    run(story())


@pytest.mark.system
def test_a_cable_that_is_pulled_in_a_print_fails_it_and_the_board_is_shown_off_when_it_is_back(
    tmp_path: Path,
):
    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(gcode(50_000))
            await one.phase(m.PrintPhase.PRINTING)
            before = read_status(one.folder / "emulator").tty
            control(one.folder / "emulator", "unplug")
            await one.until(lambda s: s.reason is not None)
            assert one.targets() != (0.0, 0.0)
            control(one.folder / "emulator", "plug")
            failed = await one.phase(m.PrintPhase.FAILED)
            assert failed.fault == "port_lost"
            last = await one.until(lambda s: s.link is not m.LinkState.BUSY)
            assert last.heaters_off
            assert one.targets() == (0.0, 0.0)
            assert read_status(one.folder / "emulator").tty != before

    run(story())


@pytest.mark.system
def test_two_swapped_cables_are_noticed_until_a_person_says_that_it_is_right(tmp_path: Path):
    async def story() -> None:
        one = Printer(tmp_path / "agent", f"sim://{MODEL}?levelled=100")
        for print_id, levelled, phase in (("p-1", 100, "done"), ("p-2", 250, "failed"), ("p-3", 250, "done")):
            one.url = f"sim://{MODEL}?levelled={levelled}"
            one.spawn()
            try:
                await one.connect()
                if print_id == "p-3":
                    await one.until(lambda s: s.link is m.LinkState.FAULT)
                    assert (await one.client.request(m.BedCleared(id=0))).error is None
                await one.ready()
                assert (await one.start(gcode(20), print_id)).error is None
                ended = await one.phase(m.PrintPhase(phase))
                assert ended.fault == ("wrong_printer" if phase == "failed" else None)
                assert ended.extruded == (phase == "done")
                if phase == "done":
                    await one.client.request(m.ForgetPrint(id=0, print_id=print_id))
            finally:
                await one.close()

    run(story())


@pytest.mark.system
def test_a_file_that_is_not_the_one_that_was_meant_heats_nothing(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            await one.start(gcode(10), sha256="0" * 64)
            failed = await one.phase(m.PrintPhase.FAILED)
            assert failed.fault == "bad_file" and not failed.extruded
            await one.start(gcode(10) + "M0\n", print_id="p-2")
            failed = (await one.until(lambda s: s.print is not None and s.print.print_id == "p-2")).print  # type: ignore[assignment]
            assert failed.fault == "bad_file" and "M0" in str(failed.reason)
            reply = await one.start(gcode(10), print_id="../p")
            assert reply.error is not None
            assert one.targets() == (0.0, 0.0)

    run(story())


@pytest.mark.system
def test_checksum_errors_and_lost_oks_are_made_good(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path, "?checksum=0.004&drop_ok=0.0005&seed=5") as one:
            await one.start(gcode(1000))
            done = await one.phase(m.PrintPhase.DONE)
            assert done.line == done.lines
            assert read_status(one.folder / "emulator").errors > 0

    run(story())


@pytest.mark.system
def test_a_printer_that_is_switched_off_is_absent_and_comes_back(tmp_path: Path):
    async def story() -> None:
        async with printer(tmp_path) as one:
            control(one.folder / "emulator", "power_off")
            gone = await one.until(lambda s: s.link is m.LinkState.ABSENT)
            assert gone.reason is not None
            refused = await one.start(gcode(10))
            assert refused.error is not None and "absent" in refused.error
            await one.ready()  # a simulated printer is switched on again by opening its port

    run(story())


@pytest.mark.system
def test_two_agents_of_one_printer_cannot_be_and_its_socket_is_private(tmp_path: Path):
    async def story() -> None:
        deep = tmp_path / ("x" * 60) / ("y" * 60)
        async with printer(deep) as one:
            assert len(str(one.folder / "agent.sock")) > 107
            assert stat.S_IMODE((one.folder / "agent.sock").stat().st_mode) == 0o600
            assert alive(one.folder)
            second = spawn("um2-01", MODEL, one.url, one.folder, one.clock)
            assert await asyncio.to_thread(second.wait, 20.0) == 1
            assert (await one.client.request(m.Hello(id=0))).snapshot is not None

    run(story())


@pytest.mark.system
def test_a_port_that_is_not_there_is_said_to_be_absent_and_the_agent_lives(tmp_path: Path):
    async def story() -> None:
        one = Printer(tmp_path / "agent", str(tmp_path / "no-such-tty"))
        one.spawn()
        try:
            await one.connect()
            said = await one.until(lambda s: s.link is m.LinkState.ABSENT)
            assert "plugged in" in str(said.reason)
            assert alive(one.folder)
        finally:
            await one.close()

    run(story())


@pytest.mark.system
def test_a_port_is_not_opened_before_somebody_says_that_its_printer_is_idle_and_its_reset_is_seen(
    tmp_path: Path,
):
    tty = tmp_path / "emulator" / "tty"
    one = Printer(tmp_path / "agent", str(tty))

    def link_open() -> bool:
        return read_status(tmp_path / "emulator").link_open

    async def story() -> None:
        try:
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)
            one.spawn()
            await one.connect()
            said = await one.until(lambda s: s.link is m.LinkState.FAULT)
            assert "does not print" in str(said.reason) and said.doubt is not None
            assert not link_open()
            refused = await one.start(gcode(10))
            assert refused.error is not None and not link_open()
            assert (await one.client.request(m.BedCleared(id=0))).error is None
            ready = await one.ready()
            assert ready.reset_verified and ready.doubt is None
            assert one.process is not None
            one.process.kill()
            one.process.wait(10.0)
            one.spawn()  # DTR has been up since: opening changes nothing
            await one.connect()
            ready = await one.ready()
            assert ready.doubt is not None
            control(tmp_path / "emulator", "power_off")
            await one.until(lambda s: s.link is m.LinkState.ABSENT)
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)  # plugged in anew
            await one.until(lambda s: s.link is m.LinkState.FAULT)
            assert not link_open()
            assert (await one.client.request(m.Commission(id=0))).error is None
            await one.ready()
        finally:
            await one.close()
            if emulator_alive(tmp_path / "emulator"):
                control(tmp_path / "emulator", "power_off")

    run(story())


@pytest.mark.system
def test_a_board_that_no_pulse_of_dtr_resets_is_not_printed_on(tmp_path: Path):
    master, slave = pty.openpty()
    tty.setraw(slave)
    one = Printer(tmp_path / "agent", os.ttyname(slave))

    def board() -> None:
        with suppress(OSError):
            while data := os.read(master, 4096):
                for line in data.split(b"\n")[:-1]:
                    os.write(master, b"ok T:21.0 /0.0 B:21.0 /0.0\n" if b"M105" in line else b"ok\n")

    threading.Thread(target=board, daemon=True).start()

    async def story() -> None:
        one.spawn()
        try:
            await one.connect()
            await one.until(lambda s: s.link is m.LinkState.FAULT)
            assert (await one.client.request(m.BedCleared(id=0))).error is None
            said = await one.until(lambda s: s.link is m.LinkState.FAULT and "DTR" in str(s.reason))
            assert not said.reset_verified
            assert (await one.start(gcode(10))).error is not None
        finally:
            await one.close()

    try:
        run(story())
    finally:
        os.close(slave)
        os.close(master)


@pytest.mark.system
@pytest.mark.parametrize(
    ("deed", "seen"),
    [
        ({"command": "move", "z_mm": 50.0}, "moved"),
        ({"command": "set_nozzle", "target_c": 180.0}, "heater"),
        ({"command": "print_sd"}, "SD card"),
        ({"command": "reset"}, "reset"),
    ],
)
def test_whoever_uses_an_idle_printer_is_seen_and_its_bed_doubted(
    tmp_path: Path, deed: dict[str, Any], seen: str
):
    async def story() -> None:
        async with printer(tmp_path) as one:
            idle = await one.until(lambda s: s.link is m.LinkState.READY and s.heaters_off)
            assert idle.doubt is None
            await asyncio.to_thread(control, one.folder / "emulator", **deed)
            doubted = await one.until(lambda s: s.doubt is not None)
            assert seen in str(doubted.doubt) or seen == "SD card"
            refused = await one.start(gcode(10))
            assert refused.error is not None
            if seen == "SD card":
                await one.until(lambda s: "SD" in str(s.reason))
                refused = await one.client.request(m.BedCleared(id=0))
                assert "SD card" in str(refused.error)
                assert read_status(one.folder / "emulator").nozzle_target_c > 0  # nobody has reset it

    run(story())


@pytest.mark.system
def test_a_printer_that_goes_away_hot_loses_its_mains_and_a_person_is_told(tmp_path: Path):
    one = Printer(tmp_path / "agent", str(tmp_path / "emulator" / "tty"))
    relay = tmp_path / "relay.sh"
    relay.write_text(f'#!/bin/sh\necho "$1" >> {tmp_path}/cut\n')
    relay.chmod(0o700)
    one.power_off_cmd = f"{relay} {{printer}}"

    async def story() -> None:
        try:
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)
            one.spawn()
            await one.connect()
            await one.until(lambda s: s.link is m.LinkState.FAULT)
            await one.client.request(m.BedCleared(id=0))
            await one.ready()
            assert (await one.start(gcode(50_000))).error is None
            await one.phase(m.PrintPhase.PRINTING)
            control(tmp_path / "emulator", "power_off")
            failed = await one.phase(m.PrintPhase.FAILED)
            assert failed.fault == "port_lost" and "mains" in str(failed.reason)
            assert (tmp_path / "cut").read_text() == "um2-01\n"
            assert not (await one.until(lambda s: s.link is m.LinkState.ABSENT)).heaters_off
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)
            back = await one.until(lambda s: s.heaters_off)  # heat of ours may be on there: it is opened
            assert back.link is m.LinkState.FAULT and "mains" in str(back.reason)
        finally:
            await one.close()
            if emulator_alive(tmp_path / "emulator"):
                control(tmp_path / "emulator", "power_off")

    run(story())


def test_nobody_there_is_an_agent_error(tmp_path: Path):
    async def story() -> None:
        client = AgentClient(tmp_path)
        with pytest.raises(AgentError):
            await client.connect(timeout_s=0.1)
        with pytest.raises(AgentError):
            await client.request(m.Hello(id=0))

    assert not alive(tmp_path)
    run(story())


def test_what_an_agent_of_another_version_says_is_understood_and_what_it_is_told_is_not_guessed():
    heater = {"now_c": 20.0, "target_c": 0.0, "power": 0.5}
    said = {
        "kind": "snapshot",
        "printer": "a",
        "agent_pid": 1,
        "link": "ready",
        "bed": heater,
        "humidity": 40,
    }
    snapshot = m.from_agent_adapter.validate_python(said)
    assert isinstance(snapshot, m.Snapshot) and snapshot.bed == m.Heater(now_c=20.0, target_c=0.0)
    with pytest.raises(ValidationError):
        m.request_adapter.validate_python({"do": "hello", "id": 1, "loudly": True})


def test_a_journal_cut_short_is_read_to_its_last_whole_record(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    ended = m.PrintSnapshot(print_id="p-1", phase=m.PrintPhase.DONE)
    opened = m.PrintSnapshot(print_id="p-2", phase=m.PrintPhase.HEATING)
    journal = Journal(path)
    journal.write(1.0, print=ended.model_dump(mode="json"), filament="parked")
    journal.write(2.0, print=opened.model_dump(mode="json"), look="smoke")
    with path.open("ab") as end:
        end.write(b'{"at_s": 3.0, "print": nu')
    memory = Journal(path).memory
    assert memory.print == opened
    assert (memory.ended, memory.filament, memory.look) == ({"p-1"}, m.Filament.PARKED, "smoke")
    Journal(path).write(4.0, look=None)
    assert Journal(path).memory.look is None


def test_a_journal_on_a_full_disk_says_so_and_keeps_its_lines_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.write(1.0, filament="parked")
    write = os.write
    with monkeypatch.context() as full:
        full.setattr(os, "write", lambda fd, data: write(fd, data[:7]))  # as the last free bytes take it
        with pytest.raises(JournalError, match="disk"):
            journal.write(2.0, filament="at_nozzle")
    assert journal.memory.filament is m.Filament.PARKED
    journal.write(3.0, look="smoke")
    memory = Journal(path).memory
    assert (memory.filament, memory.look) == (m.Filament.PARKED, "smoke")


def test_a_damaged_journal_is_read_as_far_as_it_goes_and_a_person_has_to_look(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    ended = m.PrintSnapshot(print_id="p-1", phase=m.PrintPhase.DONE)
    Journal(path).write(1.0, filament="parked")
    with path.open("ab") as end:
        end.write(b'\x00\x00\x00{"at_s": 2.0\n{"at_s": 3.0, "print": {"colour": 1}}\n')
    Journal(path).write(4.0, print=ended.model_dump(mode="json"))
    memory = Journal(path).memory
    assert memory.ended == {"p-1"}
    assert memory.look is not None and "journal" in memory.look
    Journal(path).write(5.0, look=None)  # a person did
    assert Journal(path).memory.look is None


class Driven(Agent):
    """An agent in this process, with something done at each step of its loop."""

    do: Callable[["Driven"], None]

    def _push(self) -> None:
        super()._push()
        self.do(self)

    def start(self, gcode_path: Path, text: str) -> m.Reply:
        gcode_path.write_text(text)
        digest = hashlib.sha256(text.encode()).hexdigest()
        request = m.StartPrint(
            id=1,
            print_id="p-1",
            gcode=str(gcode_path),
            sha256=digest,
            print_time_s=60.0,
            filament=m.Filament.PARKED,
        )
        return self._answer(request)

    @property
    def told(self) -> m.Snapshot:
        return self._snapshot()


@pytest.fixture
def driven(tmp_path: Path) -> Iterator[Driven]:
    clock = Clock(SCALE, time.time())
    handlers = [(number, signal.getsignal(number)) for number in (signal.SIGTERM, signal.SIGINT)]
    agent = Driven("um2-01", PROFILES[MODEL], f"sim://{MODEL}", tmp_path, clock)
    try:
        yield agent
    finally:
        signal.set_wakeup_fd(-1)
        for number, handler in handlers:
            signal.signal(number, handler)
        if emulator_alive(tmp_path / "emulator"):
            control(tmp_path / "emulator", "power_off")


@pytest.mark.system
def test_an_agent_that_fails_by_a_fault_of_its_own_switches_the_heaters_off_first(
    driven: Driven, tmp_path: Path
):
    def do(agent: Driven) -> None:
        told = agent.told
        if told.link is m.LinkState.READY:
            assert agent.start(tmp_path / "a.gcode", gcode(50_000)).error is None
        elif told.print is not None and told.print.phase is m.PrintPhase.PRINTING:
            status = read_status(tmp_path / "emulator")
            assert status.nozzle_target_c > 0
            raise ZeroDivisionError("a fault of ours")

    driven.do = do
    with pytest.raises(ZeroDivisionError):
        driven.run()
    assert settled(tmp_path / "emulator", lambda s: (s.nozzle_target_c, s.bed_target_c) == (0.0, 0.0))


@pytest.mark.system
def test_a_full_disk_stops_no_print_and_starts_none(
    driven: Driven, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    full = False
    tell = Journal.write
    seen: list[m.PrintPhase] = []

    def write(journal: Journal, at_s: float, **record: object) -> None:
        if full:
            raise JournalError("the disk is full")
        tell(journal, at_s, **record)

    monkeypatch.setattr(Journal, "write", write)

    def do(agent: Driven) -> None:
        nonlocal full
        told = agent.told
        if told.link is m.LinkState.READY and told.print is None:
            full = True
            assert "full" in str(agent.start(tmp_path / "a.gcode", gcode(300)).error)
            assert agent.told.print is None
            full = False
            assert agent.start(tmp_path / "a.gcode", gcode(300)).error is None
            full = True
        elif told.print is not None:
            seen.append(told.print.phase)
            if told.print.phase is m.PrintPhase.DONE:
                if full:
                    assert told.link is m.LinkState.BUSY  # it is not over before it is written down
                    full = False
                elif told.link is m.LinkState.READY:
                    assert agent._answer(m.Shutdown(id=2)).error is None

    driven.do = do
    driven.run()
    assert m.PrintPhase.PRINTING in seen
    memory = Journal(tmp_path / "journal.jsonl").memory
    assert memory.ended == {"p-1"} and memory.filament is m.Filament.PARKED


def settled(folder: Path, seen: Callable[[EmulatorStatus], bool]) -> bool:
    until_s = time.monotonic() + DEADLINE_S
    while not seen(read_status(folder)) and time.monotonic() < until_s:
        select.select([], [], [], 0.02)
    return seen(read_status(folder))


def test_the_spool_keeps_a_checked_copy(tmp_path: Path):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    spool = Spool(tmp_path / "spool")
    program = spool.take("p-1", source, hashlib.sha256(b"G28\n").hexdigest())
    assert program.count == 1
    assert (tmp_path / "spool" / "p-1.gcode").read_bytes() == b"G28\n"
    spool.drop("p-1")
    spool.drop("p-1")
    assert os.listdir(tmp_path / "spool") == []  # noqa: PTH208
    with pytest.raises(BadGcode, match="sha256"):
        spool.take("p-1", source, "0" * 64)
    with pytest.raises(BadGcode, match="cannot be read"):
        spool.take("p-1", tmp_path / "none", "0" * 64)
    with pytest.raises(AgentError):
        spool.check("../p-1")


def test_a_file_may_come_over_the_socket_in_pieces(tmp_path: Path):
    spool = Spool(tmp_path)
    text = b"G28\n" * 100
    for at in (0, 64, 0, 64, 128):  # begun anew after a break
        spool.put("p-1", at, text[at : at + 64])
    with pytest.raises(AgentError, match="follow"):
        spool.put("p-1", 128, b"G28\n")
    spool.put("p-1", 192, text[192:])
    program = spool.take("p-1", spool.part("p-1"), hashlib.sha256(text).hexdigest())
    assert program.count == 100
    spool.put("p-2", 0, b"left")
    Spool(tmp_path)
    assert not spool.part("p-2").exists()
    with pytest.raises(AgentError):
        spool.put("../p", 0, b"")
