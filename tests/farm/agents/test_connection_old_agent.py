"""Agent of an earlier protocol: it gets only requests that it supports, and its replacement is a task."""

import asyncio
import json
import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import ClassVar

import pytest

from drivers import messages as m
from drivers.clock import Clock
from drivers.errors import AgentTooOld
from drivers.locks import AGENT_LOCK, acquire_lock
from drivers.remote import AgentClient
from farm.agents.manager import AgentManager
from farm.config import Fleet
from farm.errors import NotFoundError, RefusedError
from farm.model import Link
from farm.paths import StateFolder
from hosts.recording_listener import RecordingListener

PRINTER_MODEL = "ultimaker2_plus"
PORT = f"sim://{PRINTER_MODEL}"
DEADLINE_S = 120.0
KNOWN_REQUESTS = {  # the requests of the first protocol, and their fields
    "hello": {"do", "id"},
    "start": {"do", "id", "print_id", "gcode", "sha256", "print_time_s", "filament"},
    "upload": {"do", "id", "print_id", "at", "data"},
    "cancel": {"do", "id", "print_id", "reason"},
    "pause": {"do", "id", "print_id"},
    "resume": {"do", "id", "print_id"},
    "forget": {"do", "id", "print_id"},
    "cleared": {"do", "id", "filament"},
    "shutdown": {"do", "id", "now"},
}
PRINT_REPORT = {"print_id": "p", "phase": "printing", "line": 10, "lines": 100, "print_time_s": 60.0}


class OldAgent:
    """Agent that is older than protocol versions; it ends the connection after an unknown request."""

    def __init__(self, folder: Path, is_printing: bool = False) -> None:
        self.folder = folder
        self.requests: list[dict[str, object]] = []
        self.connection_count = self.dropped_count = 0
        self.hello: dict[str, object] = {
            "kind": "snapshot",
            "printer": "a",
            "agent_pid": 1,
            "now_s": 0.0,
            "model": PRINTER_MODEL,
            "port": PORT,
            "link": "busy" if is_printing else "ready",
            "heaters_off": not is_printing,
            "filament": "parked",
            "print": PRINT_REPORT if is_printing else None,
        }

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connection_count += 1
        writer.write(json.dumps(self.hello).encode() + b"\n")
        while line := await reader.readline():
            request = json.loads(line)
            fields = KNOWN_REQUESTS.get(request["do"])
            if fields is None or not request.keys() <= fields:
                self.dropped_count += 1
                break
            self.requests.append(request)
            reply = {"kind": "reply", "id": request["id"], "error": None, "snapshot": self.hello}
            writer.write(json.dumps(reply).encode() + b"\n")
        writer.close()


def make_start_request(**fields: object) -> m.StartPrint:
    base_fields = {"print_id": "p", "gcode": "/x", "sha256": "0", "print_time_s": 1.0, "filament": "parked"}
    return m.StartPrint.model_validate({"id": 0, **base_fields, **fields})


def run_with_agent(
    folder: Path,
    is_printing: bool,
    run_scenario: Callable[[AgentManager, OldAgent, RecordingListener], Awaitable[None]],
) -> OldAgent:
    """Run a daemon's connections with a live agent of the first protocol."""
    state = StateFolder(folder)
    state.make()
    fleet = Fleet.model_validate({"printers": [{"name": "a", "model": PRINTER_MODEL, "port": PORT}]})
    agent_folder = state.find_agent_folder("a")
    agent_folder.mkdir(parents=True, exist_ok=True)
    agent, listener = OldAgent(agent_folder, is_printing), RecordingListener(allows_refusals=True)

    async def run() -> None:
        server = await asyncio.start_unix_server(agent.serve, agent_folder / "agent.sock")
        manager = AgentManager(fleet, state, Clock(), listener)
        manager.start(())
        try:
            async with asyncio.timeout(DEADLINE_S):
                while listener.last_snapshot is None or listener.last_snapshot.link in (
                    Link.STARTING,
                    Link.ABSENT,
                ):
                    await asyncio.sleep(0.01)
                await run_scenario(manager, agent, listener)
        finally:
            await manager.close()
            server.close()

    descriptor = acquire_lock(agent_folder / AGENT_LOCK)  # the agent is alive
    assert descriptor is not None
    try:
        asyncio.run(run())
    finally:
        os.close(descriptor)
    return agent


def test_idle_agent_of_an_earlier_protocol_gets_no_print_and_must_be_replaced(tmp_path: Path):
    async def run_scenario(manager: AgentManager, agent: OldAgent, listener: RecordingListener) -> None:
        assert (
            listener.last_snapshot is not None
            and listener.last_snapshot.link is Link.FAULT
            and listener.last_snapshot.outdated
        )
        assert "farm up --replace a" in (listener.last_snapshot.reason or "")
        connection = manager._connections["a"]
        for _ in range(3):
            connection.send(make_start_request(ends_by_s=900.0))
            connection.send(m.EndPrintBy(id=0, print_id="p", ends_by_s=900.0))
            while connection._pending_requests:
                await asyncio.sleep(0.01)
        # The print was not started, so its plate is assigned again.
        assert listener.refusals == [("p", True)] * 3
        await manager.replace_agent("a")
        with pytest.raises(NotFoundError):
            await manager.replace_agent("b")

    agent = run_with_agent(tmp_path, False, run_scenario)
    assert [request["do"] for request in agent.requests] == ["shutdown"]
    assert (agent.dropped_count, agent.connection_count) == (0, 1)


def test_print_of_an_older_agent_continues_and_can_be_cancelled(tmp_path: Path):
    async def run_scenario(manager: AgentManager, agent: OldAgent, listener: RecordingListener) -> None:
        assert (
            listener.last_snapshot is not None
            and listener.last_snapshot.link is Link.BUSY
            and not listener.last_snapshot.outdated
        )
        connection = manager._connections["a"]
        connection.send(m.EndPrintBy(id=0, print_id="p", ends_by_s=900.0))
        connection.send(m.CancelPrint(id=0, print_id="p"))
        while connection._pending_requests:
            await asyncio.sleep(0.01)

    agent = run_with_agent(tmp_path, True, run_scenario)
    assert [request["do"] for request in agent.requests] == ["cancel"]
    assert (agent.dropped_count, agent.connection_count) == (0, 1)


def test_refused_replacement_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    async def run_scenario(manager: AgentManager, agent: OldAgent, listener: RecordingListener) -> None:
        async def refuse_request(self: AgentClient, request: m.Request, timeout_s: float = 30.0) -> m.Reply:
            return m.Reply(id=1, error="it prints")

        monkeypatch.setattr(AgentClient, "request", refuse_request)
        with pytest.raises(RefusedError, match="it prints"):
            await manager.replace_agent("a")

    run_with_agent(tmp_path, False, run_scenario)


def test_client_sends_only_known_requests_to_an_older_agent(tmp_path: Path):
    agent = OldAgent(tmp_path)

    async def run_scenario() -> None:
        server = await asyncio.start_unix_server(agent.serve, tmp_path / "agent.sock")
        client = AgentClient(tmp_path)
        await client.connect()
        await anext(aiter(client.receive_snapshots()))
        # New fields have their defaults and are omitted.
        assert (await client.request(make_start_request())).error is None
        with pytest.raises(AgentTooOld):
            await client.request(make_start_request(not_after_s=1.0))
        with pytest.raises(AgentTooOld):
            await client.request(m.ListPrints(id=0, since_s=0.0))
        with pytest.raises(AgentTooOld):
            await client.request(m.ListLines(id=0))
        await client.close()
        server.close()

    asyncio.run(run_scenario())
    assert [request["do"] for request in agent.requests] == ["start"]
    assert agent.dropped_count == 0


def test_new_request_is_not_sent_to_an_older_agent():
    class NewerRequest(m.Hello):
        first_protocol: ClassVar[int] = m.PROTOCOL + 1

    assert m.encode_for_protocol(NewerRequest(id=1), m.PROTOCOL) is None
    assert m.encode_for_protocol(NewerRequest(id=1), m.PROTOCOL + 1) is not None


@pytest.mark.parametrize("request_", [make_start_request(not_after_s=1.0, ends_by_s=2.0), m.Hello(id=3)])
def test_agent_of_this_version_gets_every_request(request_: m.Request):
    line = m.encode_for_protocol(request_, m.PROTOCOL)
    assert line is not None and m.request_adapter.validate_json(line) == request_
