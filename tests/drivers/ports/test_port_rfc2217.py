"""A port on another host, behind a real ser2net."""

import asyncio
import os
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control, launch, read_status
from drivers.errors import PortError
from drivers.firmware import ULTIMAKER2
from drivers.link import BoardConnected, Link, Report
from drivers.link.dialogue import exchange
from drivers.ports import NetPort, WireRecord
from drivers.remote import AgentClient, spawn_agent
from drivers.safety import StopTarget, stop_printer
from printers.agent_with_emulator import wait_for_emulator

MODEL = "ultimaker2_plus"
DEADLINE_S = 120.0
pytestmark = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # raised in pyserial
SER2NET = shutil.which("ser2net", path="/usr/sbin:" + os.environ["PATH"])
C_COMPILER = shutil.which("cc") or shutil.which("tcc")


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """Start an emulated printer behind ser2net, with the DTR of `modem_lines.c`."""
    if SER2NET is None or C_COMPILER is None:
        pytest.skip("needs ser2net and a C compiler")
    emulator = tmp_path / "emulator"
    launch(f"sim://{MODEL}", emulator, Clock(60.0, time.time()))
    modem_lines = tmp_path / "lines.so"
    source = Path(__file__).with_name("modem_lines.c")
    subprocess.run([C_COMPILER, "-shared", "-fPIC", "-nostdlib", "-o", modem_lines, source], check=True)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port_number = probe.getsockname()[1]
    (tmp_path / "ser2net.yaml").write_text(
        f"%YAML 1.1\n---\nconnection: &a\n  accepter: telnet(rfc2217),tcp,127.0.0.1,{port_number}\n"
        f"  connector: serialdev,{(emulator / 'tty').resolve()},115200n81,local\n"
        "  options: {mdns: false, mdns-sysattrs: false}\n"
    )
    (tmp_path / "reset.py").write_text(
        "from pathlib import Path\nfrom drivers.emulator.launch import control\n"
        f"control(Path({str(emulator)!r}), 'reset')\n"
    )
    reset = f"env -u LD_PRELOAD {sys.executable} {tmp_path}/reset.py"
    env = {**os.environ, "LD_PRELOAD": str(modem_lines), "RESET": reset}
    command = [SER2NET, "-n", "-d", "-c", str(tmp_path / "ser2net.yaml")]
    with (tmp_path / "ser2net.log").open("wb") as log:
        server = subprocess.Popen(command, env=env, stdout=log, stderr=log, cwd=Path(__file__).parents[3])
    try:
        _wait_until_listening(port_number)
        yield f"rfc2217://127.0.0.1:{port_number}"
    finally:
        server.kill()
        server.wait()
        control(emulator, "power_off")


def _wait_until_listening(port_number: int) -> None:
    """Wait until the kernel lists the listening socket, because a trial connection would open the port."""
    deadline_s = time.monotonic() + DEADLINE_S
    while f":{port_number:04X} 00000000:0000 0A" not in Path("/proc/net/tcp").read_text():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


@pytest.mark.system
def test_bytes_and_dtr_reach_a_board_behind_ser2net(tmp_path: Path, url: str):
    port = NetPort(url, ULTIMAKER2.baud_rate)
    try:
        link = Link(ULTIMAKER2)
        assert any(isinstance(event, BoardConnected) for _, event in exchange(port, link, DEADLINE_S))
        resets = read_status(tmp_path / "emulator").resets
        port.reset()
        link = Link(ULTIMAKER2)
        for now_s, event in exchange(port, link, DEADLINE_S):
            if isinstance(event, BoardConnected):
                assert event.has_restarted and event.banner
                link.poll(now_s)
            elif isinstance(event, Report):
                assert event.targets_off
                break
        else:
            raise AssertionError("no report")
        assert read_status(tmp_path / "emulator").resets == resets + 1
        port.write_now(b"\nM104 S150\n")
        assert wait_for_emulator(tmp_path / "emulator", lambda status: status.nozzle_target_c == 150.0)
    finally:
        port.close()
    assert stop_printer(StopTarget("a", url, tmp_path / "a", ULTIMAKER2)).is_confirmed_off


@pytest.mark.system
def test_agent_opens_the_port_after_a_person_confirms_that_it_is_idle(tmp_path: Path, url: str):
    folder = tmp_path / "agent"
    process = spawn_agent("a", MODEL, url, folder, Clock(60.0, time.time()))

    async def run_scenario() -> None:
        client = AgentClient(folder)
        is_requested = False
        await client.connect()
        try:
            async with asyncio.timeout(DEADLINE_S):
                async for snapshot in client.receive_snapshots():
                    if snapshot.link is m.LinkState.FAULT and not is_requested:
                        is_requested = True
                        assert not read_status(tmp_path / "emulator").link_open
                        assert (await client.request(m.BedCleared(id=0))).error is None
                    if snapshot.link is m.LinkState.READY and snapshot.nozzle is not None:
                        assert is_requested and snapshot.reset_verified
                        break
        finally:
            await client.close()

    try:
        asyncio.run(run_scenario())
    finally:
        process.kill()
        process.wait()


def test_host_that_does_not_answer_is_a_port_error():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port_number = probe.getsockname()[1]
    with pytest.raises(PortError, match="ser2net"):
        NetPort(f"rfc2217://127.0.0.1:{port_number}", ULTIMAKER2.baud_rate)


def test_bytes_in_both_directions_are_recorded():
    record = WireRecord(time.time)
    port = NetPort("loop://", ULTIMAKER2.baud_rate, record)  # pyserial's port that receives what it sends
    try:
        port.write(b"M105\n")
        data = b""
        while not data.endswith(b"\n"):
            assert select.select([port.fileno()], [], [], DEADLINE_S)[0]
            data += port.read()
        port.write_now(b"M112\n")
    finally:
        port.close()
    lines = [(line.sent, line.text) for line in record.list_lines()]
    assert lines == [(True, "M105"), (False, "M105"), (True, "M112")]
