"""Uploads: one, several at once, and those refused for lack of disk space."""

import asyncio
import io
import shutil
import tempfile
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from books.recording_controller import make_fleet
from decompose.files.triangle_limit import HEAD_BYTES
from farm.api import UploadView
from farm.config import UploadsSection
from farm.errors import ErrorCode, FarmError, NotFoundError, RefusedError
from farm.http.uploads import Upload, Uploads, check_quota
from farm.model import JobOptions
from farm.paths import StateFolder
from farm.planning import make_inspection_step_path

QUOTA = UploadsSection(model_gb=2.0, at_once=2, free_gb=1.0, open_jobs=3)
MB, GB = 10**6, 10**9


@pytest.mark.parametrize(
    ("size", "missing_bytes", "free_bytes", "jobs", "reason"),
    [
        (2 * GB + 1, (), 100 * GB, 0, r"a.stl is 2.0 GB.*fleet.uploads.model_gb"),
        (MB, (MB, MB), 100 * GB, 0, "checking 2 models.*again in a moment.*fleet.uploads.at_once"),
        (MB, (), 100 * GB, 3, "3 open jobs already.*farm cancel JOB.*fleet.uploads.open_jobs"),
        (MB, (), GB, 0, r"would leave 1.0 GB free .*1 GB must stay free.*fleet.uploads.free_gb"),
        (GB, (GB,), 3 * GB - 1, 0, "would leave"),  # the other upload has not arrived yet
        (GB, (), GB // 2, 0, "would leave 0.0 GB"),
    ],
)
def test_each_limit_of_uploads_is_named_with_its_key(size, missing_bytes, free_bytes, jobs, reason):
    with pytest.raises(RefusedError, match=reason):
        check_quota(QUOTA, "a.stl", size, missing_bytes, free_bytes, jobs)


def test_upload_within_all_limits_is_accepted():
    check_quota(QUOTA, "a.stl", GB, (GB,), 3 * GB, 2)
    check_quota(UploadsSection(free_gb=0.0), "a.stl", GB, (), 0, 999)


def test_open_uploads_count_until_their_inspection_ends(tmp_path, monkeypatch):
    """Count open uploads: each one frees its place when its stream ends."""
    state = StateFolder(tmp_path)
    state.make()
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=100 * GB))

    async def run_uploads():
        inspection_may_end, inspection_started = asyncio.Event(), asyncio.Event()

        async def run(*_):
            inspection_started.set()
            await inspection_may_end.wait()
            return "inspected"

        section = make_fleet().fleet.model_copy(update={"uploads": UploadsSection(at_once=1)})
        controller = SimpleNamespace(
            fleet=make_fleet().model_copy(update={"fleet": section}), books=SimpleNamespace(jobs={})
        )
        inspections: dict[Path, str] = {}
        workers = SimpleNamespace(run=run, start_step="loading the planning code", memory_bytes=GB)
        uploads = Uploads(controller, state, workers, inspections)

        async def send_content():
            yield b"solid"

        first_upload = asyncio.create_task(
            uploads.receive_model(send_content(), "a", "a.stl", 5, JobOptions())
        )
        await inspection_started.wait()
        assert uploads.describe("a").step == "waiting for the workers to start: loading the planning code"
        workers.start_step = None
        assert uploads.describe("a").step == "waiting for a worker"
        assert list(inspections.values()) == ["a.stl"]
        make_inspection_step_path(next(state.work.glob("upload-*"))).write_text("repairing")
        assert uploads.describe("a") == UploadView(step="repairing", received=5, size=5)
        with pytest.raises(NotFoundError):
            uploads.describe("b")
        with pytest.raises(RefusedError, match="receiving and checking 1 model"):
            await uploads.receive_model(send_content(), "b", "b.stl", 5, JobOptions())
        inspection_may_end.set()
        assert await first_upload == "inspected"
        with pytest.raises(RefusedError, match="stopped after 5 of 6 bytes"):
            await uploads.receive_model(send_content(), "c", "c.stl", 6, JobOptions())
        assert await uploads.receive_model(send_content(), "d", "d.stl", 5, JobOptions()) == "inspected"
        assert list(state.work.iterdir()) == []
        assert inspections == {}

    asyncio.run(run_uploads())


def test_stl_with_too_many_triangles_is_refused_before_the_rest_of_it_arrives(tmp_path, monkeypatch):
    state = StateFolder(tmp_path)
    state.make()
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=100 * GB))
    controller = SimpleNamespace(fleet=make_fleet(), books=SimpleNamespace(jobs={}))
    uploads = Uploads(controller, state, SimpleNamespace(memory_bytes=GB), {})
    size = 84 + 50 * 4_000_000

    async def send_content():
        yield b"\0" * 40  # the header may come in pieces
        yield b"\0" * 40 + (4_000_000).to_bytes(4, "little")
        yield b"\0" * HEAD_BYTES
        raise AssertionError("nothing more is read")

    expected_text = (
        r"big.STL: has 4.0 million triangles.*simplify its mesh, or raise `fleet.compute.memory_gb`"
    )
    with pytest.raises(FarmError, match=expected_text) as error:
        asyncio.run(uploads.receive_model(send_content(), "a", "big.STL", size, JobOptions()))
    assert error.value.code is ErrorCode.LIMIT
    assert list(state.work.iterdir()) == []


class SlowFile(io.BytesIO):
    """File on a disk that blocks writes until it is released."""

    def __init__(self):
        super().__init__()
        self.may_write, self.written_bytes = threading.Event(), b""

    def write(self, content):
        assert self.may_write.wait(30), "may_write was never set: the event loop was waiting for the disk"
        self.written_bytes += content
        return super().write(content)


def test_slow_disk_delays_only_its_own_upload(tmp_path, monkeypatch):
    file, chunk = SlowFile(), b"x" * 2**21
    upload = Upload("a", 3 * len(chunk), tmp_path / "upload", GB)
    monkeypatch.setattr(Path, "open", lambda *_: file)

    async def receive_content():
        async with upload.open_file("a.gcode") as append:
            for _ in range(3):
                await append(chunk)

    async def upload_slowly():
        receive_task = asyncio.create_task(receive_content())
        await asyncio.sleep(0)  # the file is being written while the loop continues
        assert (file.written_bytes, receive_task.done()) == (b"", False)
        file.may_write.set()
        await receive_task

    asyncio.run(upload_slowly())
    assert file.written_bytes == 3 * chunk


@settings(deadline=None)
@given(st.lists(st.binary(max_size=2000), max_size=40))
def test_content_in_any_pieces_is_written_in_order(pieces):
    with tempfile.TemporaryDirectory() as folder:
        upload = Upload("a", sum(map(len, pieces)), Path(folder) / "upload", GB)

        async def receive_content():
            async with upload.open_file("a.gcode") as append:
                for piece in pieces * 40:
                    await append(piece)

        asyncio.run(receive_content())
        assert upload.path.read_bytes() == b"".join(pieces * 40)
