"""Recorded uploads of libcurl and Qt on a real connection: answers, and files after a cut."""

import asyncio
import socket
import struct
import tempfile
from contextlib import closing, suppress
from pathlib import Path

import pytest

from clusters.same_process import SameProcess
from farm.model import Role
from farms.served_farm import serve
from farms.slicer_farm import SlicerFarm

FOLDER = Path(__file__).parent / "recorded"
RECORDED_KEY = b"farm_" + b"a" * 8 + b"_" + b"A" * 43
HEALTH_REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
CONTINUE_REPLY = b"HTTP/1.1 100 "
CHUNK_SIZES = (1, 7, 1000, 10**6)
UPLOADS = {  # name of the recording -> name of the job's model, whether it is held, its note
    "libcurl-print": ("part.gcode", False, None),
    "libcurl-upload": ("part.gcode", True, None),
    "libcurl-file-first": ("part.gcode", False, None),
    "libcurl-odd-name": ("Größe %222%22 (1).gcode", True, "a/b"),
    "libcurl-moonraker": ("part.gcode", False, None),
    "qt-print": ("part.gcode", False, None),
    "qt-upload": ("part.gcode", True, None),
    "qt-odd-name": ("Größe 2 (1).gcode", True, None),
}


@pytest.fixture
def farm(tmp_path, monkeypatch):
    """Make a farm with its own folder for temporary files."""
    temporary_folder = tmp_path / "temporary"
    temporary_folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary_folder))
    farm = SlicerFarm(tmp_path)
    farm.temporary_folder, farm.key_text = temporary_folder, farm.add_key(Role.PRINT).text.encode()
    return farm


def read_recording(name, farm):
    return (FOLDER / f"{name}.http").read_bytes().replace(RECORDED_KEY, farm.key_text)


class Connections:
    """Client that opens one connection to the server after the other."""

    def __init__(self, port, server):
        self._port, self._server = port, server

    async def send(self, *chunks):
        """Send a request, and return its answers, including an interim answer."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        with closing(writer):
            for chunk in chunks:
                writer.write(chunk)
                await writer.drain()
            answer = await reader.readuntil(b"\r\n\r\n")
            if answer.startswith(CONTINUE_REPLY):
                answer += await reader.readuntil(b"\r\n\r\n")
            answer += await reader.readexactly(int(read_answer(answer)[1]["content-length"]))
        await self._wait_until_idle()
        return answer

    async def send_head(self, data):
        """Send a part of a request, and return the head of the answer."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        with closing(writer):
            writer.write(data)
            answer = await reader.readuntil(b"\r\n\r\n")
        await self._wait_until_idle()
        return answer

    async def send_part(self, data, is_reset):
        """Send only a part of a request; return the answer."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        writer.write(data)
        await writer.drain()
        if is_reset:
            linger = struct.pack("ii", 1, 0)
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        with closing(writer):
            answer = b"" if is_reset else await self._read_rest(reader, writer)
        await self._wait_until_idle()
        return answer

    @staticmethod
    async def _read_rest(reader, writer):
        with suppress(ConnectionError):
            writer.write_eof()
            return await reader.read()
        return b""

    async def _wait_until_idle(self):
        state = self._server._server.server_state
        async with asyncio.timeout(60):
            while state.tasks or state.connections:
                await asyncio.sleep(0)


def split_data(data, size):
    return [data[index : index + size] for index in range(0, len(data), size)]


def read_answer(answer):
    """Return the status, the headers in lower case, and the body of the final answer."""
    head, _, body = answer.partition(b"\r\n\r\n")
    if answer.startswith(CONTINUE_REPLY):
        head, _, body = body.partition(b"\r\n\r\n")
    status, *lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines)
    return int(status.split()[1]), headers, body.decode()


@pytest.mark.parametrize("name", UPLOADS)
def test_recorded_upload_becomes_a_job_however_it_is_split(name, farm):
    model, is_held, note = UPLOADS[name]

    async def run_scenario():
        async with serve(farm) as (port, server):
            connections = Connections(port, server)
            return [
                await connections.send(*split_data(read_recording(name, farm), size)) for size in CHUNK_SIZES
            ]

    for answer in asyncio.run(run_scenario()):
        status, headers, _ = read_answer(answer)
        assert status == 201, answer
        assert "api/" in headers["location"] or name == "libcurl-moonraker"
    assert {(job.name, job.options.hold, job.options.note) for job in farm.jobs_by_number.values()} == {
        (model, is_held, note)
    }
    assert len(farm.jobs_by_number) == len(CHUNK_SIZES)
    assert (farm.unfinished_uploads, list(farm.temporary_folder.iterdir())) == ([], [])


def test_continue_is_sent_to_libcurl_unless_its_key_is_wrong(farm):
    recording = read_recording("libcurl-print", farm)
    head = recording[: recording.index(b"\r\n\r\n") + 4]

    async def run_scenario():
        async with serve(farm) as (port, server):
            connections = Connections(port, server)
            answer = await connections.send(head.replace(farm.key_text, RECORDED_KEY))
            return await connections.send_head(head), answer

    interim_answer, result = asyncio.run(run_scenario())
    assert interim_answer.startswith(CONTINUE_REPLY)
    assert read_answer(result)[0] == 401


@pytest.mark.parametrize(
    ("name", "is_reset"),
    [("libcurl-print", False), ("libcurl-file-first", True), ("qt-print", False)],
)
def test_upload_cut_at_any_byte_leaves_no_job_and_no_file(name, is_reset, farm):
    recording, event_count = read_recording(name, farm), len(farm.controller._store.read_all_events())
    old_files = {path for path in farm.state.root.rglob("*") if path.is_file()}

    async def run_scenario():
        async with serve(farm) as (port, server):
            connections = Connections(port, server)
            for end in range(len(recording)):
                answer = await connections.send_part(recording[:end], is_reset)
                assert b" 201 " not in answer, end
                assert (len(farm.jobs_by_number), farm.unfinished_uploads) == (0, []), end
                assert read_answer(await connections.send(HEALTH_REQUEST))[0] == 200, end
            assert {path for path in farm.state.root.rglob("*") if path.is_file()} == old_files
            assert (len(farm.controller._store.read_all_events()), list(farm.temporary_folder.iterdir())) == (
                event_count,
                [],
            )
            return await connections.send(recording)

    assert read_answer(asyncio.run(run_scenario()))[0] == 201
    assert len(farm.jobs_by_number) == 1


def test_refusal_of_gcode_is_one_line_of_text_that_begins_with_line_and_reason(farm):
    farm.services.uploads._workers = SameProcess()
    recording = read_recording("qt-print", farm).replace(b"M109 S205", b"M109 S999")

    async def run_scenario():
        async with serve(farm) as (port, server):
            connections = Connections(port, server)
            return await connections.send(recording)

    status, headers, text = read_answer(asyncio.run(run_scenario()))
    assert (status, headers["content-type"]) == (400, "text/plain")
    assert text.startswith("line 5: M109 sets 999 C, but the limit of the nozzle is 260 C")
    assert (farm.jobs_by_number, farm.unfinished_uploads) == ({}, [])
