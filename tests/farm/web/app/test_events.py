"""Streams of the event log: complete, without secrets, and ended by the daemon or with the key."""

import asyncio
import json
from contextlib import ExitStack

import pytest

from books.recording_controller import INSPECTED_MODEL
from farm.errors import RefusedError
from farm.http.event_streams import EmptyEventLog, EventStreams
from farm.model import JobOptions, Role
from farm.state.event_rows import EventRow
from farms.web_farm import HOST, WebFarm, get_network_path
from hosts.fake_event_loop_clock import FakeTime

EVENTS_PATH = get_network_path("/events")


@pytest.fixture
def farm(tmp_path):
    farm = WebFarm(tmp_path)
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(note="a note"), "ann")
    yield farm
    farm.store.close()


def read_stream(text):
    """Return the ids and the events of a stream."""
    parts = [part for part in text.split("\n\n") if part and part != ":"]
    fields = [dict(line.split(": ", 1) for line in part.splitlines()) for part in parts]
    return [
        (int(event_fields["id"]), json.loads(event_fields["data"]))
        for event_fields in fields
        if "data" in event_fields
    ]


def test_stream_has_all_events_after_a_number(farm):
    key = farm.add_key(Role.LOOK)
    response = farm.ask("GET", EVENTS_PATH, key, params={"since": 0, "wait": "false"})
    assert response.headers["content-type"].startswith("text/event-stream")
    events = read_stream(response.text)
    assert [number for number, _ in events] == list(range(1, farm.store.find_last_event_number() + 1))
    assert [event["kind"] for _, event in events] == [kind for _, kind, _ in farm.store.read_all_events()]
    later_response = farm.ask("GET", EVENTS_PATH, key, params={"since": 2, "wait": "false"})
    assert read_stream(later_response.text) == events[2:]
    repeated_response = farm.ask(
        "GET", EVENTS_PATH, key, headers={"Last-Event-ID": "3"}, params={"since": 0, "wait": "false"}
    )
    assert read_stream(repeated_response.text) == events[3:]
    assert read_stream(farm.ask("GET", EVENTS_PATH, key, params={"wait": "false"}).text) == []


def test_event_names_job_and_person_but_no_file_and_no_hash(farm):
    key = farm.add_key(Role.LOOK)
    text = farm.ask("GET", EVENTS_PATH, key, params={"since": 0, "wait": "false"}).text
    submitted_event = next(event for _, event in read_stream(text) if event["kind"] == "JobSubmitted")
    assert (submitted_event["job"], submitted_event["by"]) == (1, "ann")
    assert farm.controller.books.keys[key.id].digest not in text
    assert INSPECTED_MODEL.file not in text
    assert "r" * 8 not in text
    assert text == farm.ask_socket("GET", "/events", params={"since": 0, "wait": "false"}).text


def test_number_that_the_log_does_not_have_yet_is_refused(farm):
    key = farm.add_key(Role.LOOK)
    response = farm.ask("GET", EVENTS_PATH, key, params={"since": 1000})
    assert response.status_code == 409
    assert f"since={farm.store.find_last_event_number()}" in response.json()["error"]
    for number in ("x", "-1", str(2**63)):
        assert farm.ask("GET", EVENTS_PATH, key, headers={"Last-Event-ID": number}).status_code == 400


def follow_stream(farm, key, on_text):
    """Open a stream, call `on_text` with its text at each chunk, and return the text at its end."""
    scope = {
        "type": "http",
        "method": "GET",
        "path": EVENTS_PATH,
        "query_string": b"",
        "headers": [(b"host", HOST.encode()), (b"x-api-key", key.text.encode())],
        "client": ("10.0.0.9", 1),
    }
    chunks = []

    async def receive():
        await asyncio.Event().wait()

    async def send(message):
        chunks.append(message.get("body", b"").decode())
        on_text("".join(chunks))

    asyncio.run(farm.web(scope, receive, send))
    return "".join(chunks)


def test_stream_shows_a_new_event_and_ends_when_the_key_is_revoked(farm):
    key = farm.add_key(Role.LOOK)

    def on_text(text):
        if "retry" in text and "JobCancelled" not in text:
            farm.jobs.cancel(1, "bob")
        elif text.endswith(":\n\n") and farm.controller.books.keys[key.id].revoked_s is None:  # a heartbeat
            farm.keys.revoke(key.id, "ann")

    text = follow_stream(farm, key, on_text)
    cancelled_event = next(event for _, event in read_stream(text) if event["kind"] == "JobCancelled")
    assert (cancelled_event["job"], cancelled_event["by"]) == (1, "bob")
    assert "KeyRevoked" not in text


def test_stream_ends_with_the_daemon_and_its_place_is_free_again(farm):
    key = farm.add_key(Role.LOOK)
    streams = farm.services.streams
    for _ in range(4):
        streams.check_caller("key look")
        with streams.count_stream("key look"):
            pass

    def on_text(text):
        if "retry" in text:
            streams.close()

    follow_stream(farm, key, on_text)
    assert streams._counts_by_caller.total() == 0
    with pytest.raises(RefusedError, match="shutting down"):
        streams.check_caller("key look")


def test_streams_are_limited_for_a_caller_and_in_total():
    streams = EventStreams(EmptyEventLog(), limit=6)
    with ExitStack() as open_streams:
        for caller in ("ann", "ann", "ann", "ann", "bob", "bob"):
            streams.check_caller(caller)
            open_streams.enter_context(streams.count_stream(caller))
        with pytest.raises(RefusedError, match="4 of ann"):
            streams.check_caller("ann")
        with pytest.raises(RefusedError, match="0 of eve"):
            streams.check_caller("eve")
    streams.check_caller("ann")


def test_long_log_is_sent_in_order(monkeypatch):
    class LongLog(EmptyEventLog):
        def read_events(self, last_number, limit):
            return [
                EventRow(n, 0.0, "JobMoved")
                for n in range(last_number + 1, min(last_number + limit, 1000) + 1)
            ]

    async def read_numbers():
        rows = EventStreams(LongLog()).follow(17, lambda: True, wait=False)
        return [row.number async for batch in rows for row in batch]

    assert FakeTime(monkeypatch, 0.0).run(read_numbers()) == list(range(18, 1001))
