"""The daemon's connections to real agents."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from books.make_books import apply_events, make_planned_books
from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control, launch
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.remote import find_agent_pid, heartbeat, is_alive, kill_agent
from farm.agents import connection
from farm.agents.connection import AgentConnection
from farm.agents.manager import AgentManager
from farm.agents.protocol_adapter import compute_clock_offset_s, to_agent_clock, to_farm_snapshot
from farm.config import Fleet, PrinterSection
from farm.model import AgentSnapshot, Link
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import Books
from hosts.recording_listener import RecordingListener

PRINTER_MODEL = "ultimaker2_plus"
DEADLINE_S = 120.0


def make_simulated_farm(folder: Path) -> tuple[StateFolder, Fleet, RecordingListener]:
    """Make a state folder, and a fleet of one simulated printer."""
    state = StateFolder(folder)
    state.make()
    fleet = Fleet.model_validate(
        {"printers": [{"name": "a", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"}]}
    )
    return state, fleet, RecordingListener()


async def wait_until_ready(
    manager: AgentManager, listener: RecordingListener, old_pid: int | None = None
) -> int:
    """Wait for an agent other than `old_pid` that is ready, and return its pid."""
    async with asyncio.timeout(DEADLINE_S):
        while True:
            manager.watch()
            report = listener.last_snapshot
            if report is not None and report.link is Link.READY and report.agent_pid not in (None, old_pid):
                assert report.agent_pid is not None and not report.outdated
                return report.agent_pid
            await asyncio.sleep(0.1)


@pytest.mark.system
def test_hung_agent_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(heartbeat, "SAMPLE_SILENCE_S", 1.0)
    monkeypatch.setattr(heartbeat, "HUNG_SILENCE_S", 8.0)
    state, fleet, listener = make_simulated_farm(tmp_path)

    async def run_scenario() -> None:
        manager = AgentManager(fleet, state, Clock(60.0, time.time()), listener)
        manager.start(())
        try:
            first_pid = await wait_until_ready(manager, listener)
            os.kill(first_pid, signal.SIGSTOP)
            second_pid = await wait_until_ready(manager, listener, first_pid)
            assert find_agent_pid(state.find_agent_folder("a")) == second_pid
            await manager.shut_down_agents()
            assert not is_alive(state.find_agent_folder("a"))
        finally:
            await manager.close()

    try:
        asyncio.run(run_scenario())
    finally:
        pid = find_agent_pid(state.find_agent_folder("a"))
        if pid is not None:
            os.kill(pid, signal.SIGKILL)
        if emulator_is_running(state.find_agent_folder("a") / "emulator"):
            control(state.find_agent_folder("a") / "emulator", "power_off")


@pytest.mark.system
def test_shutdown_ends_an_agent_that_has_just_started(tmp_path: Path):
    state, fleet, listener = make_simulated_farm(tmp_path)

    async def run_scenario() -> None:
        manager = AgentManager(fleet, state, Clock(60.0, time.time()), listener)
        manager.start(())
        process = manager._connections["a"]._process
        assert process is not None
        try:
            async with asyncio.timeout(DEADLINE_S):
                await manager.shut_down_agents()
            assert process.poll() == 0
        finally:
            await manager.close()

    try:
        asyncio.run(run_scenario())
    finally:
        kill_agent(state.find_agent_folder("a"))
        if emulator_is_running(state.find_agent_folder("a") / "emulator"):
            control(state.find_agent_folder("a") / "emulator", "power_off")


def make_printing_snapshot(started_s: float) -> m.Snapshot:
    """Make the report of an agent whose print starts at this moment of its clock."""
    print_snapshot = m.PrintSnapshot(print_id="p", phase=m.PrintPhase.PRINTING, started_s=started_s)
    fields = {"protocol": m.PROTOCOL, "agent_pid": 1, "link": m.LinkState.BUSY}
    return m.Snapshot.model_validate({**fields, "printer": "a", "now_s": started_s, "print": print_snapshot})


@pytest.mark.parametrize(
    ("clock_offset_s", "correction_s"), [(0.0, 0.0), (-20.0, 0.0), (3600.0, -3600.0), (-3e7, 3e7)]
)
def test_times_of_an_agent_with_another_clock_are_corrected(clock_offset_s: float, correction_s: float):
    clock = Clock()
    started_s = clock.now() + clock_offset_s
    snapshot = make_printing_snapshot(started_s)
    received_print = to_farm_snapshot(snapshot, clock, "a", True, False).print
    assert received_print is not None
    assert received_print.started_s == pytest.approx(started_s + correction_s, abs=30.0)
    assert compute_clock_offset_s(snapshot, clock) == pytest.approx(correction_s, abs=30.0)


@pytest.mark.parametrize("step_s", [30.0, -30.0, 6 * 3600.0, -6 * 3600.0])
@pytest.mark.parametrize("is_agent_started_later", [False, True])
def test_agents_agree_on_deadlines_with_a_daemon_whose_clock_was_set(
    step_s: float, is_agent_started_later: bool
):
    """Start the agent before or after the host's clock is set."""
    daemon_clock = Clock(host_shift_s=step_s)
    agent_clock = Clock(host_shift_s=step_s if is_agent_started_later else 0.0)
    started_s = agent_clock.now()
    snapshot = make_printing_snapshot(started_s)
    received_print = to_farm_snapshot(snapshot, daemon_clock, "a", True, False).print
    assert received_print is not None and received_print.started_s is not None
    # A difference of less than a minute may be caused by the transfer alone.
    tolerance_s = 30.0 if is_agent_started_later and abs(step_s) < 60.0 else 5.0
    assert daemon_clock.now() - received_print.started_s == pytest.approx(0.0, abs=tolerance_s + 5.0)
    deadline_s = daemon_clock.now() + 600.0
    sent_request = to_agent_clock(
        make_start_request(None, deadline_s), compute_clock_offset_s(snapshot, daemon_clock), deadline_s
    )
    assert isinstance(sent_request, m.StartPrint)
    assert sent_request.not_after_s is not None
    assert sent_request.not_after_s - agent_clock.now() == pytest.approx(600.0, abs=35.0)
    assert sent_request.ends_by_s == sent_request.not_after_s


class RecordingConnection:
    """Connection that records the requests to be sent."""

    def __init__(self) -> None:
        self.requests: list[m.Request] = []

    def send(self, request: m.Request) -> None:
        self.requests.append(request)


def test_start_is_sent_with_its_limits_and_changed_limits_later(tmp_path: Path):
    books, _ = apply_events(
        make_planned_books(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="p")
    )
    manager = AgentManager(
        Fleet.model_validate({"printers": []}), StateFolder(tmp_path), Clock(), RecordingListener()
    )
    recorder = RecordingConnection()
    manager._connections["a"] = recorder  # type: ignore[assignment]
    start_instruction = ev.SendStart(print_id="p", printer="a", not_after_s=500.0, ends_by_s=900.0)
    manager.perform(start_instruction, books, tmp_path)
    manager.perform(ev.SendEndBy(print_id="p", printer="a", ends_by_s=800.0), books, tmp_path)
    start_request, end_request = recorder.requests
    assert isinstance(start_request, m.StartPrint)
    assert (start_request.not_after_s, start_request.ends_by_s) == (500.0, 900.0)
    assert end_request == m.EndPrintBy(id=0, print_id="p", ends_by_s=800.0)


def make_start_request(not_after_s: float | None, ends_by_s: float | None) -> m.StartPrint:
    fields = {"print_id": "p", "gcode": None, "sha256": "0", "print_time_s": 1.0, "filament": "parked"}
    limits = {"not_after_s": not_after_s, "ends_by_s": ends_by_s}
    return m.StartPrint.model_validate({"id": 0, **fields, **limits})


def test_requests_have_times_by_the_clock_of_the_agent():
    sent_request = to_agent_clock(make_start_request(None, None), -3600.0, 1000.0)
    assert sent_request == make_start_request(4600.0, None)
    assert to_agent_clock(make_start_request(500.0, 2000.0), -3600.0, 1000.0) == make_start_request(
        4100.0, 5600.0
    )
    assert to_agent_clock(make_start_request(5000.0, 2000.0), 0.0, 1000.0) == make_start_request(
        1000.0, 2000.0
    )
    end_request = m.EndPrintBy(id=0, print_id="p", ends_by_s=2000.0)
    assert to_agent_clock(end_request, 500.0, 1000.0) == end_request.model_copy(update={"ends_by_s": 1500.0})
    unlimited_request = end_request.model_copy(update={"ends_by_s": None})
    for request in (unlimited_request, m.Hello(id=0)):
        assert to_agent_clock(request, 500.0, 1000.0) == request


@pytest.mark.system
def test_renamed_printer_opens_the_port_of_its_former_agent(tmp_path: Path):
    state = StateFolder(tmp_path / "state")
    state.make()
    clock = Clock(1.0, time.time())
    port = launch(f"sim://{PRINTER_MODEL}", tmp_path / "emulator", clock)
    listener = RecordingListener()

    def make_fleet(name: str) -> Fleet:
        return Fleet.model_validate({"printers": [{"name": name, "model": PRINTER_MODEL, "port": str(port)}]})

    async def wait_until(manager: AgentManager, link: Link) -> None:
        async with asyncio.timeout(DEADLINE_S):
            while listener.last_snapshot is None or listener.last_snapshot.link is not link:
                manager.watch()
                await asyncio.sleep(0.05)

    async def run_scenario() -> None:
        old_manager = AgentManager(make_fleet("old"), state, clock, listener)
        old_manager.start(())
        await wait_until(old_manager, Link.FAULT)  # no person has allowed the port to be opened yet
        old_manager.perform(ev.SendCleared(printer="old", filament=None), Books(), tmp_path)
        await wait_until(old_manager, Link.READY)
        await old_manager.close()
        listener.last_snapshot = None
        new_manager = AgentManager(make_fleet("new"), state, clock, listener)
        new_manager.start(())
        try:
            await wait_until(new_manager, Link.FAULT)
            new_manager.perform(ev.SendCleared(printer="new", filament=None), Books(), tmp_path)
            await wait_until(new_manager, Link.READY)
            assert not is_alive(state.find_agent_folder("old"))
            old_process = old_manager._connections["old"]._process
            assert old_process is not None and old_process.wait(10.0) == 0
        finally:
            await new_manager.shut_down_agents()
            await new_manager.close()

    try:
        asyncio.run(run_scenario())
    finally:
        kill_agent(state.find_agent_folder("old"))
        control(tmp_path / "emulator", "power_off")


class FakeClient:
    """Agent that answers every request with its snapshot, but uploads only when allowed."""

    def __init__(self) -> None:
        self.sent_requests: list[m.Request] = []
        self.answer_allowed = asyncio.Event()
        self.snapshot = m.Snapshot(protocol=m.PROTOCOL, printer="a", agent_pid=7, link=m.LinkState.ABSENT)

    async def request(self, request: m.Request) -> m.Reply:
        self.sent_requests.append(request)
        if isinstance(request, m.Upload):
            await self.answer_allowed.wait()
        return m.Reply(id=request.id, snapshot=self.snapshot)


def run_connection(  # type: ignore[no-untyped-def]
    tmp_path: Path, run_scenario, port: str = "/dev/null"
) -> tuple[FakeClient, RecordingListener]:
    """Run a scenario on a connection; return its client and the listener."""
    listener = RecordingListener()
    section = PrinterSection(name="a", model=PRINTER_MODEL, port=port)

    async def main() -> FakeClient:
        agent_connection = AgentConnection("a", section, StateFolder(tmp_path), Clock(), listener)
        client = FakeClient()
        agent_connection._client = client  # type: ignore[assignment]
        await run_scenario(agent_connection, client)
        await asyncio.gather(*agent_connection._tasks)
        return client

    return asyncio.run(main()), listener


def test_reply_of_an_agent_confirms_a_cancellation(tmp_path: Path):
    async def run_scenario(agent_connection, client):  # type: ignore[no-untyped-def]
        agent_connection.send(m.CancelPrint(id=0, print_id="x"))

    _, listener = run_connection(tmp_path, run_scenario)
    snapshot = listener.last_snapshot
    assert snapshot is not None
    assert (snapshot.link, snapshot.agent_pid, snapshot.acknowledged_cancel) == (Link.ABSENT, 7, "x")


class TalkingClient(FakeClient):
    """Agent that sends a message to each client on connection."""

    connection_count = 0

    async def connect(self) -> None:
        self.connection_count += 1

    async def receive_snapshots(self) -> AsyncIterator[m.Snapshot]:
        yield self.snapshot

    async def close(self) -> None:
        pass


def test_internal_error_does_not_stop_listening_to_an_agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(connection, "RETRY_INTERVAL_S", 0.001)

    class FaultyListener(RecordingListener):
        snapshot_count = 0

        def on_snapshot(self, snapshot: AgentSnapshot) -> None:
            self.snapshot_count += 1
            if self.snapshot_count < 5:
                raise ZeroDivisionError("internal error")
            super().on_snapshot(snapshot)

    async def main(listener: FaultyListener) -> None:
        agent_connection = AgentConnection("a", None, StateFolder(tmp_path), Clock(), listener)
        agent_connection._client = TalkingClient()  # type: ignore[assignment]
        listen_task = asyncio.ensure_future(agent_connection._listen())
        async with asyncio.timeout(DEADLINE_S):
            while listener.last_snapshot is None:
                assert not listen_task.done()
                await asyncio.sleep(0.001)
        agent_connection._is_stopping = True
        await listen_task

    asyncio.run(main(FaultyListener()))


@pytest.mark.parametrize(("port", "bed_clear"), [("/dev/ttyACM0", None), (f"sim://{PRINTER_MODEL}", True)])
def test_snapshot_counts_for_the_printer_of_its_agent_and_only_an_emulator_reports_its_bed(
    tmp_path: Path, port: str, bed_clear: bool | None
):
    misnamed_snapshot = m.Snapshot(
        protocol=m.PROTOCOL, printer="b", agent_pid=7, link=m.LinkState.READY, bed_clear=True
    )

    async def run_scenario(agent_connection, client):  # type: ignore[no-untyped-def]
        client.snapshot = misnamed_snapshot
        agent_connection.send(m.CancelPrint(id=0, print_id="x"))

    _, listener = run_connection(tmp_path, run_scenario, port)
    snapshot = listener.last_snapshot
    assert snapshot is not None
    assert (snapshot.printer, snapshot.link, snapshot.bed_clear) == ("a", Link.READY, bed_clear)


def test_print_cancelled_during_its_upload_does_not_start(tmp_path: Path):
    gcode = tmp_path / "x.gcode"
    gcode.write_text("G28\n")
    start = m.StartPrint(
        id=0, print_id="x", gcode=str(gcode), sha256="0", print_time_s=1.0, filament=m.Filament.PARKED
    )

    async def run_scenario(agent_connection, client):  # type: ignore[no-untyped-def]
        agent_connection._is_remote = True
        agent_connection.send(start)
        while not client.sent_requests:
            await asyncio.sleep(0)
        agent_connection.send(m.CancelPrint(id=0, print_id="x"))
        await asyncio.sleep(0)
        client.answer_allowed.set()

    client, _ = run_connection(tmp_path, run_scenario)
    assert {type(item) for item in client.sent_requests} == {m.Upload, m.CancelPrint}


@pytest.mark.system
def test_idle_agent_is_replaced_without_a_change_to_its_printer(tmp_path: Path):
    state, fleet, listener = make_simulated_farm(tmp_path)

    async def run_scenario() -> None:
        manager = AgentManager(fleet, state, Clock(60.0, time.time()), listener)
        manager.start(())
        try:
            first_pid = await wait_until_ready(manager, listener)
            await manager.replace_agent("a")
            agent_folder = state.find_agent_folder("a")
            assert await wait_until_ready(manager, listener, first_pid) == find_agent_pid(agent_folder)
            assert emulator_is_running(agent_folder / "emulator")
        finally:
            await manager.shut_down_agents()
            await manager.close()

    asyncio.run(run_scenario())
