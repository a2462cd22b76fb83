"""Hosts that are lost while the daemon restarts: their loss is not reported twice."""

import asyncio
from pathlib import Path

from drivers.host import HostState
from farm.agents import hosts
from farm.config import Fleet
from farm.paths import StateFolder
from farm.state import events as ev
from hosts.manual_clock import ManualClock
from hosts.recording_listener import RecordingListener

PRINTER_MODEL = "ultimaker2_plus"


def test_restarted_daemon_reports_the_return_of_a_host_but_not_its_loss_again(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("FARM_SSH", "false")
    fields = {"model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}", "host_command": "farm host"}
    rows = [{"name": f"of-{host}", "host": host, **fields} for host in ("pc-a", "pc-b")]
    fleet, clock, listener = Fleet.model_validate({"printers": rows}), ManualClock(), RecordingListener()
    connections = hosts.Hosts(fleet, StateFolder(tmp_path), clock, listener)

    async def restart() -> None:
        connections.start(lost_hosts={"pc-a"})
        await connections.close()

    asyncio.run(restart())
    clock.now_s += 60.0
    connections.watch()
    assert [(type(event), event.host) for event in listener.events] == [(ev.HostLost, "pc-b")]
    listener.events.clear()
    for record in connections.records:
        record.on_state(clock.now_s, HostState(pid=1))
    connections.watch()
    assert [(type(event), event.host) for event in listener.events] == [
        (ev.HostConnected, "pc-a"),
        (ev.HostConnected, "pc-b"),
    ]
    assert listener.warnings == {}
