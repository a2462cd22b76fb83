"""Client of an agent's socket."""

import asyncio
from pathlib import Path

import pytest
from pydantic import ValidationError

from drivers import messages as m
from drivers.errors import AgentError
from drivers.remote import AgentClient, is_alive
from printers.agent_with_emulator import run


def test_connection_and_request_fail_without_an_agent(tmp_path: Path):
    async def run_scenario() -> None:
        client = AgentClient(tmp_path)
        with pytest.raises(AgentError):
            await client.connect(timeout_s=0.1)
        with pytest.raises(AgentError):
            await client.request(m.Hello(id=0))

    assert not is_alive(tmp_path)
    run(run_scenario())


def test_unknown_fields_are_ignored_in_snapshots_and_refused_in_requests():
    heater = {"now_c": 20.0, "target_c": 0.0, "power": 0.5}
    fields = {
        "kind": "snapshot",
        "printer": "a",
        "agent_pid": 1,
        "link": "ready",
        "bed": heater,
        "humidity": 40,
    }
    snapshot = m.from_agent_adapter.validate_python(fields)
    assert isinstance(snapshot, m.Snapshot) and snapshot.bed == m.Heater(now_c=20.0, target_c=0.0)
    with pytest.raises(ValidationError):
        m.request_adapter.validate_python({"do": "hello", "id": 1, "loudly": True})


def test_unreadable_message_counts_as_a_sign_of_life(tmp_path: Path):
    signs: list[bool] = []

    async def send_message(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b'{"kind": "snapshot", "printer": "a", "agent_pid": 1, "link": "floating"}\n')
        await writer.drain()
        writer.close()

    async def run_scenario() -> None:
        server = await asyncio.start_unix_server(send_message, tmp_path / "agent.sock")
        client = AgentClient(tmp_path, on_message=lambda: signs.append(True))
        await client.connect()
        assert [snapshot async for snapshot in client.receive_snapshots()] == []
        await client.close()
        server.close()

    run(run_scenario())
    assert signs  # the agent is alive, so its print must not be ended
