"""Agent on another host, over a connection that can be cut."""

import asyncio
import hashlib
import json
import os
import pwd
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control, launch, read_status
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.errors import AgentError
from drivers.records import StartFile
from drivers.remote import BridgeRequest, BridgeTask, client, find_agent_pid, is_alive
from drivers.remote.bridge import find_folder
from drivers.remote.ssh import SSH_COMMAND
from farm.agents import connection, remote
from farm.agents.connection import AgentConnection
from farm.agents.manager import AgentManager
from farm.config import Fleet, PrinterSection
from farm.model import AgentSnapshot, Link, PrintState
from farm.paths import StateFolder
from hosts.host_pipe import HostPipe
from hosts.recording_listener import RecordingListener
from hosts.silent_network import SilentRoute

PRINTER_MODEL = "ultimaker2_plus"
SCALE = 120.0
DEADLINE_S = 120.0
OUTAGE_S = 600.0  # by the farm's clock
OUTAGE_MOVES = 100  # moves within an outage, more than a printer buffers; each takes a second
SSHD = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin:" + os.environ["PATH"])
HEAD = "G21\nG90\nM82\nM107\nG28\nM109 S210\nG1 F2400 Z20\nG92 E0\nG1 F47 E7.8\nG92 E0\n"
TAIL = "G92 E0\nG1 F1500 E-6.5\nM104 S0\nM140 S0\nM107\nG91\nG1 F1500 E-13.5\nG90\nG28\nM84\n"


class Sshd:
    """Real sshd on this host, with its own keys and configuration."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for key in ("host", "mine"):
            arguments = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / key)]
            subprocess.run(arguments, check=True)
        (folder / "sshd").write_text(
            f"HostKey {folder}/host\nAuthorizedKeysFile {folder}/mine.pub\nStrictModes no\nUsePAM no\n"
            f"PidFile none\nPasswordAuthentication no\nListenAddress 127.0.0.1\nPort {self._find_port()}\n"
        )
        (folder / "ssh").write_text(
            f"Host pc-b\n HostName 127.0.0.1\n Port {self._port}\n IdentityFile {folder}/mine\n"
            f" IdentitiesOnly yes\n StrictHostKeyChecking no\n"
            f" UserKnownHostsFile {folder}/known\n LogLevel ERROR\n"
        )
        self.ssh = f"{SSH_COMMAND} -F {folder}/ssh"
        self._server: subprocess.Popen[bytes] | None = None
        self.reconnect()

    def _find_port(self) -> int:
        import socket

        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port: int = probe.getsockname()[1]
        return self._port

    def reconnect(self) -> None:
        if os.getuid() == 0:
            Path("/run/sshd").mkdir(exist_ok=True)  # as the unit of openssh-server does
        arguments = [str(SSHD), "-D", "-e", "-f", str(self._folder / "sshd")]
        self._server = subprocess.Popen(arguments, stderr=subprocess.DEVNULL, start_new_session=True)

    def cut(self) -> None:
        """Cut the network: server and connections end, and neither program is notified."""
        assert self._server is not None
        if self._server.poll() is not None:
            return
        for child in list_children(self._server.pid):
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        self._server.kill()
        self._server.wait()

    def close(self) -> None:
        self.cut()


def _has_sshd_user() -> bool:
    """Return whether sshd can separate privileges; as root it needs the user `sshd` for that."""
    with suppress(KeyError):
        return os.getuid() != 0 or bool(pwd.getpwnam("sshd"))
    return False


def list_children(pid: int) -> list[int]:
    """List the server's processes for its connections, without the processes that these started."""
    results = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            head, _, stat = path.read_text().rpartition(")")
            if stat.split()[1] == str(pid) and head.endswith("(sshd"):
                child = int(path.parent.name)
                results += [child, *list_children(child)]
    return results


class SilentNetwork(SilentRoute):
    """Connection that stays open but no longer transmits."""

    def __init__(self, folder: Path) -> None:
        super().__init__()

    def count_ended_bridges(self) -> int:
        """Count the bridges that have noticed a lost client."""
        return sum(bridge.poll() is not None for bridge in self.bridges)


@pytest.fixture(params=[HostPipe, Sshd])
def remote_host(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Any]:
    if request.param is Sshd and (SSHD is None or not _has_sshd_user()):
        pytest.skip("needs openssh-server, and as root its user sshd")
    folder = tmp_path / "way"
    folder.mkdir()
    host = request.param(folder)
    monkeypatch.setenv("FARM_SSH", host.ssh)
    try:
        yield host
    finally:
        host.close()
        agent = tmp_path / "there" / "farm-agents" / "test" / "a"
        pid = find_agent_pid(agent)
        if pid is not None:
            os.kill(pid, signal.SIGKILL)
        if emulator_is_running(agent / "emulator"):
            control(agent / "emulator", "power_off")


@pytest.mark.system
@pytest.mark.parametrize("remote_host", [HostPipe, Sshd, SilentNetwork], indirect=True)
def test_print_survives_a_network_failure_of_ten_minutes(
    tmp_path: Path, remote_host: Any, monkeypatch: pytest.MonkeyPatch
):
    if isinstance(remote_host, SilentNetwork):  # ten minutes by the farm's clock take five seconds
        monkeypatch.setattr(connection, "_SILENCE_TIMEOUT_S", 1.5)
        monkeypatch.setattr(connection, "_MAX_WAIT_S", 0.5)
        monkeypatch.setattr(client, "FIRST_MESSAGE_TIMEOUT_S", 10.0)
    remote_folder = tmp_path / "there" / "farm-agents" / "test" / "a"
    section = PrinterSection(
        name="a",
        model=PRINTER_MODEL,
        port=f"sim://{PRINTER_MODEL}",
        host="pc-b",
        host_command=f"XDG_STATE_HOME={tmp_path}/there {sys.executable} -m drivers.remote.bridge",
    )
    state, listener, clock = StateFolder(tmp_path / "here"), RecordingListener(), Clock(SCALE, time.time())
    state.make()
    moves = "".join(
        f"G1 F6000 X{50 + 100 * (i % 2)} Y{50 + i % 100} Z0.3 E{i * 0.5:.2f}\n" for i in range(1200)
    )
    text = (HEAD + moves + TAIL).encode()
    gcode = tmp_path / "only-here.gcode"
    gcode.write_bytes(text)

    async def wait_until(condition: Any) -> AgentSnapshot:
        async with asyncio.timeout(DEADLINE_S):
            while listener.last_snapshot is None or not condition(listener.last_snapshot):
                await asyncio.sleep(0.05)
            return listener.last_snapshot

    async def run_scenario() -> None:
        agent_connection = AgentConnection("a", section, state, clock, listener, "test")
        agent_connection.start()
        try:
            await wait_until(lambda s: s.link is Link.READY)
            sha256 = hashlib.sha256(text).hexdigest()
            agent_connection.send(
                m.StartPrint(
                    id=0,
                    print_id="p-1",
                    gcode=str(gcode),
                    sha256=sha256,
                    print_time_s=900.0,
                    filament=m.Filament.PARKED,
                )
            )
            await wait_until(lambda s: s.print is not None and s.print.state is PrintState.PRINTING)
            first_pid = find_agent_pid(remote_folder)
            started_s = clock.now()
            remote_host.cut()
            last_move = read_status(remote_folder / "emulator").moves + OUTAGE_MOVES
            await wait_until(lambda s: s.link is Link.STARTING)
            async with asyncio.timeout(DEADLINE_S):
                while (
                    clock.now() < started_s + OUTAGE_S
                    or read_status(remote_folder / "emulator").moves < last_move
                ):
                    assert is_alive(remote_folder)
                    await asyncio.sleep(0.05)
            remote_host.reconnect()
            snapshot = await wait_until(lambda s: s.print is not None and s.print.state.ended)
            assert snapshot.print is not None and snapshot.print.state is PrintState.DONE, snapshot
            assert find_agent_pid(remote_folder) == first_pid
            if isinstance(remote_host, SilentNetwork):
                async with asyncio.timeout(DEADLINE_S):
                    while remote_host.count_ended_bridges() < len(remote_host.bridges) - 1:
                        await asyncio.sleep(0.05)
                assert len(remote_host.bridges) >= 2
            await agent_connection.close()
            listener.last_snapshot = None
            # The printer has been removed from the fleet meanwhile.
            agent_connection = AgentConnection("a", None, state, clock, listener)
            agent_connection.start()
            await wait_until(lambda s: s.print is not None and s.print.state.ended)
            await agent_connection.shut_down()
            async with asyncio.timeout(DEADLINE_S):
                while is_alive(remote_folder):
                    await asyncio.sleep(0.05)
        finally:
            await agent_connection.close()

    asyncio.run(run_scenario())


@pytest.mark.system
def test_estop_stops_a_printer_on_another_host_and_names_an_unreachable_one(tmp_path: Path, remote_host: Any):
    command = f"XDG_STATE_HOME={tmp_path}/there {sys.executable} -m drivers.remote.bridge"
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        f"fleet: {{name: test}}\ndefaults: {{host: pc-b, host_command: '{command}'}}\n"
        f"printers:\n  - {{name: a, model: {PRINTER_MODEL}, port: 'sim://{PRINTER_MODEL}'}}\n"
    )
    remote_folder = tmp_path / "there" / "farm-agents" / "test" / "a"
    launch(f"sim://{PRINTER_MODEL}", remote_folder / "emulator", Clock(SCALE, time.time()))
    estop_command = [
        Path(sys.executable).with_name("farm"),
        "estop",
        "--state",
        tmp_path / "here",
        "--fleet",
        fleet,
    ]
    result = subprocess.run(estop_command, check=False, capture_output=True, text=True, timeout=90)
    assert result.returncode == 0 and "confirmed off" in result.stdout, result
    assert read_status(remote_folder / "emulator").resets == 1
    remote_host.cut()
    result = subprocess.run(estop_command, check=False, capture_output=True, text=True, timeout=90)
    assert result.returncode == 1 and "a: cannot be stopped (pc-b:" in result.stdout, result


@pytest.mark.system
@pytest.mark.parametrize("remote_host", [HostPipe], indirect=True)
def test_idle_agent_of_a_removed_printer_is_ended_on_its_host(tmp_path: Path, remote_host: Any):
    command = f"XDG_STATE_HOME={tmp_path}/there {sys.executable} -m drivers.remote.bridge"
    remote_folder = tmp_path / "there" / "farm-agents" / "test" / "a"
    state, clock = StateFolder(tmp_path / "here"), Clock(SCALE, time.time())
    state.make()
    route_file = state.find_agent_folder("a") / "way.json"

    def make_manager(*names: str) -> AgentManager:
        fields = {
            "model": PRINTER_MODEL,
            "port": f"sim://{PRINTER_MODEL}",
            "host": "pc-b",
            "host_command": command,
        }
        printers = [{"name": "b", "enabled": False, **fields}, *({"name": n, **fields} for n in names)]
        fleet_fields = {"fleet": {"name": "test"}, "printers": printers}
        return AgentManager(Fleet.model_validate(fleet_fields), state, clock, RecordingListener())

    async def wait_until(condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(DEADLINE_S):
            while not condition():
                await asyncio.sleep(0.05)

    async def run_scenario() -> None:
        old_manager = make_manager("a")
        old_manager.start(())
        await wait_until(lambda: is_alive(remote_folder))
        await old_manager.close()
        for _ in range(2):  # the second time, no agent is running there
            route_text = route_file.read_text()
            new_manager = make_manager()
            new_manager.start(())
            await wait_until(lambda: not route_file.exists())
            await wait_until(lambda: not is_alive(remote_folder))
            await new_manager.close()
            route_file.write_text(route_text)

    asyncio.run(run_scenario())


@pytest.mark.parametrize("text", ["", "null", "[1, 2]", '["a"]', "{}", "[[], 5]"])
def test_damaged_route_file_is_ignored(text, tmp_path):
    (tmp_path / "way.json").write_text(text)
    remote.remove_start_file(remote.load_route(tmp_path, None, "", Clock()))


def test_names_of_farm_and_printer_cannot_lead_out_of_the_folder():
    for farm, printer in (("..", "a"), ("test", ".."), ("test", "a/b"), ("", "a")):
        with pytest.raises(AgentError):
            find_folder(farm, printer)


def test_request_to_a_bridge_survives_serialisation():
    request = BridgeRequest(
        BridgeTask.STOP, "test", StartFile("a", PRINTER_MODEL, "/dev/x", 1.0, 2.0, "relay")
    )
    assert BridgeRequest.parse(request.serialise()) == request
    for line in (b"", b"{}", b'{"do": "dance", "farm": "x", "start": {}}', json.dumps([1]).encode()):
        with pytest.raises(AgentError):
            BridgeRequest.parse(line)
