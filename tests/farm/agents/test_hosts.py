"""Printers of another host on one connection, with real processes."""

import asyncio
import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control, read_status
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.host.stop import stop_printers_on_host
from drivers.locks import find_holder, is_locked
from drivers.records import StartFile
from drivers.remote import find_agent_pid, is_alive
from drivers.safety import StopResult
from farm.agents import host_record, hosts
from farm.agents.manager import AgentManager
from farm.config import Fleet
from farm.errors import FarmError
from farm.model import Link, PrintState
from farm.paths import StateFolder
from farm.state import events as ev
from hosts.host_pipe import HostPipe
from hosts.recording_listener import RecordingListener

PRINTER_MODEL = "ultimaker2_plus"
SCALE = 240.0
DEADLINE_S = 120.0
NAMES = ("a", "b")
HEAD = "G21\nG90\nM82\nM107\nG28\nM109 S210\nG1 F2400 Z20\nG92 E0\nG1 F47 E7.8\nG92 E0\n"
TAIL = "G92 E0\nG1 F1500 E-6.5\nM104 S0\nM140 S0\nM107\nG91\nG1 F1500 E-13.5\nG90\nG28\nM84\n"


@pytest.fixture
def pipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[HostPipe]:
    pipe = HostPipe(tmp_path)
    monkeypatch.setenv("FARM_SSH", pipe.ssh)
    try:
        yield pipe
    finally:
        pipe.close(*NAMES)
        for name in NAMES:
            if emulator_is_running(pipe.paths.find_agent_folder(name) / "emulator"):
                control(pipe.paths.find_agent_folder(name) / "emulator", "power_off")


async def wait_for(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(DEADLINE_S):
        while not condition():
            await asyncio.sleep(0.02)


def make_fleet(pipe: HostPipe) -> Fleet:
    fields = {
        "model": PRINTER_MODEL,
        "port": f"sim://{PRINTER_MODEL}",
        "host": "pc-b",
        "host_command": pipe.command,
    }
    return Fleet.model_validate(
        {
            "fleet": {"name": "test", "time_scale": SCALE},
            "printers": [{"name": name, **fields} for name in NAMES],
        }
    )


@asynccontextmanager
async def connect_agents(
    pipe: HostPipe, state: StateFolder, clock: Clock, listener: RecordingListener
) -> AsyncIterator[AgentManager]:
    """Connect a manager to the two agents, and watch them as the daemon does."""
    manager = AgentManager(make_fleet(pipe), state, clock, listener)

    async def watch() -> None:
        while True:
            manager.watch()
            await asyncio.sleep(0.05)

    manager.start(())
    watch_task = asyncio.create_task(watch())
    try:
        yield manager
    finally:
        watch_task.cancel()
        await manager.close()


@pytest.mark.system
def test_print_survives_the_death_of_the_host_service_and_of_the_network(
    tmp_path: Path, pipe: HostPipe, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(hosts, "_MAX_WAIT_S", 0.2)
    monkeypatch.setattr(host_record, "LOSS_DELAY_S", 1.0)
    state, listener, clock = StateFolder(tmp_path / "here"), RecordingListener(), Clock(SCALE, time.time())
    state.make()
    moves = "".join(
        f"G1 F6000 X{50 + 100 * (i % 2)} Y{50 + i % 100} Z0.3 E{i * 0.5:.2f}\n" for i in range(300)
    )
    text = (HEAD + moves + TAIL).encode()
    (tmp_path / "a.gcode").write_bytes(text)

    async def run_scenario() -> None:
        async with connect_agents(pipe, state, clock, listener) as manager:
            await wait_for(lambda: listener.list_links(NAMES) == {Link.READY})
            assert len(pipe.pids) == 1  # one connection for both printers
            start_request = m.StartPrint(
                id=0,
                print_id="p-1",
                gcode=str(tmp_path / "a.gcode"),
                sha256=hashlib.sha256(text).hexdigest(),
                print_time_s=900.0,
                filament=m.Filament.PARKED,
            )
            manager._connections["a"].send(start_request)
            await wait_for(lambda: PrintState.PRINTING in listener.print_states["a"])
            old_pids = {name: find_agent_pid(pipe.paths.find_agent_folder(name)) for name in NAMES}
            service = find_holder(pipe.paths.lock_file)
            assert service is not None
            os.kill(service, signal.SIGKILL)
            await wait_for(lambda: listener.last_snapshots["a"].host_lost)
            await wait_for(
                lambda: not listener.last_snapshots["a"].host_lost and listener.last_snapshots["a"].print
            )
            assert find_holder(pipe.paths.lock_file) != service
            assert {name: find_agent_pid(pipe.paths.find_agent_folder(name)) for name in NAMES} == old_pids
            await wait_for(lambda: listener.is_host_connected("pc-b"))
            listener.events.clear()
            pipe.cut()
            await wait_for(lambda: listener.events)
            (loss,) = listener.events
            assert isinstance(loss, ev.HostLost) and loss.printers == NAMES
            assert all(listener.last_snapshots[name].host_lost for name in NAMES)
            assert is_alive(pipe.paths.find_agent_folder("a")) and is_locked(pipe.paths.lock_file)
            pipe.reconnect()
            await wait_for(
                lambda: listener.last_snapshots["a"].print and listener.last_snapshots["a"].print.state.ended
            )
            assert listener.print_states["a"][-1] is PrintState.DONE, listener.last_snapshots["a"]
            assert find_agent_pid(pipe.paths.find_agent_folder("a")) == old_pids["a"]
            await wait_for(lambda: listener.is_host_connected("pc-b"))
            assert [type(event) for event in listener.events] == [ev.HostLost, ev.HostConnected]

    asyncio.run(run_scenario())


@pytest.mark.system
def test_host_service_restarts_an_agent_without_the_daemon_and_passes_on_estop_and_shutdown(
    tmp_path: Path, pipe: HostPipe
):
    state, listener, clock = StateFolder(tmp_path / "here"), RecordingListener(), Clock(SCALE, time.time())
    state.make()
    folders = {name: pipe.paths.find_agent_folder(name) for name in NAMES}

    async def kill_agent_and_wait_for_restart() -> None:
        async with connect_agents(pipe, state, clock, listener):
            await wait_for(lambda: listener.list_links(NAMES) == {Link.READY})
        killed_pid = find_agent_pid(folders["a"])
        assert killed_pid is not None
        os.kill(killed_pid, signal.SIGKILL)
        await wait_for(lambda: find_agent_pid(folders["a"]) not in (None, killed_pid))

    asyncio.run(kill_agent_and_wait_for_restart())
    fleet = tmp_path / "fleet.yaml"
    rows = "".join(
        f"  - {{name: {name}, model: {PRINTER_MODEL}, port: 'sim://{PRINTER_MODEL}'}}\n" for name in NAMES
    )
    fleet.write_text(
        f"fleet: {{name: test}}\ndefaults: {{host: pc-b, host_command: '{pipe.command}'}}\nprinters:\n{rows}"
    )
    command = [Path(sys.executable).with_name("farm"), "estop", "--state", state.root, "--fleet", fleet]
    connection_count = len(pipe.pids)
    stop_result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=90)
    assert stop_result.returncode == 0 and stop_result.stdout.count("confirmed off") == 2, stop_result
    assert len(pipe.pids) == connection_count + 1
    assert all(read_status(folder / "emulator").resets for folder in folders.values())

    async def shut_down_and_wait() -> None:
        async with connect_agents(pipe, state, clock, listener) as manager:
            listener.last_snapshots.clear()
            await wait_for(lambda: not listener.list_links(NAMES) & {Link.STARTING, Link.CONNECTING})
            await manager.shut_down_agents()
            await wait_for(lambda: not any(map(is_alive, folders.values())))

    asyncio.run(shut_down_and_wait())
    pipe.cut()
    results: list[StopResult] = []
    stop_printers_on_host(
        "pc-b",
        pipe.command,
        "test",
        [StartFile("b", PRINTER_MODEL, f"sim://{PRINTER_MODEL}")],
        results.append,
    )
    assert [result.text for result in results] == [
        "cannot be stopped (pc-b: no route); switch the printer off"
    ]


def test_host_with_two_commands_is_refused(tmp_path: Path) -> None:
    fields = {"model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}", "host": "pc-b"}
    printers = [{"name": name, "host_command": f"/opt/farm-{name}/bin/farm host", **fields} for name in NAMES]
    fleet = Fleet.model_validate({"printers": printers})
    clock = Clock(1.0, 0.0)
    with pytest.raises(FarmError, match="the printers of pc-b have different commands"):
        hosts.Hosts(fleet, StateFolder(tmp_path), clock, RecordingListener())
