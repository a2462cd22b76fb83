"""Cameras of a farm: polling for viewers, stored stills, and dead cameras."""

import asyncio
import json
import logging

import pytest

from books.make_books import make_end_event, make_job, make_plan_event
from books.recording_controller import PLUS_MODEL, RecordedEffects
from farm.cameras.cameras import Cameras
from farm.cameras.fetch import CameraError
from farm.cameras.image import read_image
from farm.config import Fleet
from farm.control import Controller
from farm.errors import ErrorCode, FarmError, NotFoundError
from farm.model import Moment, PrintState
from farm.paths import StateFolder
from farm.planning.printer_settings import list_bed_boxes
from farm.state import events as ev
from farm.state.retention import list_deletable_files, list_referenced_files
from farm.state.storage.store import Store
from hosts.fake_camera import make_jpeg
from hosts.manual_clock import ManualClock

URL = "http://look:pass-w0rd@camera-{printer}/still"
IMAGE = read_image(make_jpeg())


class CameraRig:
    """Farm with printer `a`, which has a camera, and printer `b`; the test sets the answers of the camera."""

    def __init__(self, folder):
        rows = [{"name": name, "model": PLUS_MODEL, "port": f"sim://{PLUS_MODEL}"} for name in "ab"]
        rows[0]["camera"] = URL
        self.state = StateFolder(folder / "state")
        self.state.make()
        self.store = Store(self.state.books)
        self.clock = ManualClock(200.0)
        fleet = Fleet.model_validate({"printers": rows})
        self.controller = Controller(fleet, self.store, self.clock, list_bed_boxes)
        self.controller.start(RecordedEffects())
        self.now_s, self.requests, self.answer = 1000.0, [], IMAGE
        self.cameras = Cameras(self.controller, self.state, self.fetch_image, lambda: self.now_s)

    async def fetch_image(self, url):
        self.requests.append(url)
        await asyncio.sleep(0)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def run_print(self, state=PrintState.DONE):
        self.controller.handle(
            ev.JobSubmitted(at_s=0.0, job=make_job()),
            ev.PlanningStarted(at_s=0.0, job=1),
            make_plan_event(plates=1),
        )
        self.controller.handle(
            ev.BedCleared(at_s=1.5, printer="a", by="ann"),
            ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
            make_end_event("x", state),
        )
        return "x"

    async def tick(self):
        self.cameras.tick()
        while self.cameras._store_tasks:
            await asyncio.gather(*self.cameras._store_tasks.values())


@pytest.fixture
def rig(tmp_path):
    rig = CameraRig(tmp_path)
    yield rig
    rig.store.close()


def test_camera_is_polled_once_for_all_viewers_and_at_most_every_two_seconds(rig):
    async def fetch_repeatedly():
        assert await asyncio.gather(*(rig.cameras.fetch_still("a") for _ in range(20))) == [IMAGE] * 20
        rig.now_s += 1.9
        assert await rig.cameras.fetch_still("a") == IMAGE
        assert len(rig.requests) == 1
        rig.now_s += 0.1
        await rig.cameras.fetch_still("a")

    asyncio.run(fetch_repeatedly())
    assert rig.requests == [URL.replace("{printer}", "a")] * 2


def test_camera_without_viewers_is_not_polled_and_its_still_is_dropped(rig):
    async def tick_without_viewers():
        await rig.cameras.fetch_still("a")
        for _ in range(100):
            rig.now_s += 1.0
            await rig.tick()

    asyncio.run(tick_without_viewers())
    assert len(rig.requests) == 1
    assert rig.cameras._cameras["a"].latest_still is None


def test_printer_without_a_camera_and_unknown_printers_are_errors(rig):
    for name, message in (("b", "b has no camera: give its address with `camera`"), ("c", "no printer c")):
        with pytest.raises(NotFoundError, match=message):
            asyncio.run(rig.cameras.fetch_still(name))


@pytest.mark.parametrize("answer", [CameraError("it is dead"), ValueError("pass-w0rd")])
def test_dead_camera_is_logged_once_and_polled_less_often(rig, caplog, answer):
    caplog.set_level(logging.INFO)
    rig.answer = answer

    async def fetch_repeatedly():
        for _ in range(300):  # a viewer for five minutes
            with pytest.raises(FarmError, match="the camera of a: it") as error:
                await rig.cameras.fetch_still("a")
            assert error.value.code is ErrorCode.UNREACHABLE
            rig.now_s += 1.0
        assert len(rig.requests) == 8  # after 4, 8, 16, 32 s, then each minute
        rig.answer = IMAGE
        rig.now_s += 60.0
        assert await rig.cameras.fetch_still("a") == IMAGE

    asyncio.run(fetch_repeatedly())
    lines = [record.message for record in caplog.records if record.name.startswith("farm.cameras")]
    assert len(lines) == 2 and "pass-w0rd" not in caplog.text
    assert lines[0].startswith("a: its camera sends no still: it")
    assert lines[1] == "a: its camera sends stills again"


@pytest.mark.parametrize(
    ("state", "moment"), [(PrintState.DONE, Moment.END), (PrintState.FAILED, Moment.FAILURE)]
)
def test_still_is_kept_with_the_print_when_it_ends(rig, state, moment):
    print_id = rig.run_print(state)
    asyncio.run(rig.tick())
    rig.now_s += 10.0
    asyncio.run(rig.tick())
    assert len(rig.requests) == 1
    (still,) = rig.controller.books.prints[print_id].stills
    assert (still.moment, still.at_s) == (moment, 200.0)
    assert (rig.state.files / still.file).read_bytes() == make_jpeg()
    assert still.file in list_referenced_files(rig.controller.books)
    assert not list(rig.state.work.iterdir())


def test_camera_that_answers_late_gives_a_still_within_a_minute(rig):
    print_id = rig.run_print()
    rig.answer = CameraError("it is dead")
    asyncio.run(rig.tick())
    rig.answer = IMAGE
    for _ in range(3):
        asyncio.run(rig.tick())  # not requested again immediately
    assert len(rig.requests) == 1
    rig.now_s += 4.0
    asyncio.run(rig.tick())
    assert len(rig.controller.books.prints[print_id].stills) == 1


def test_still_that_cannot_be_stored_is_logged_and_changes_nothing(rig, caplog):
    print_id = rig.run_print()
    rig.state.files.rmdir()
    asyncio.run(rig.tick())
    assert rig.controller.books.prints[print_id].stills == ()
    assert "a: a still cannot be stored" in caplog.text
    assert not list(rig.state.work.iterdir())
    for _ in range(14):  # a full disk must not cause requests every two seconds for hours
        rig.now_s += 4.0
        asyncio.run(rig.tick())
    assert len(rig.requests) == 1
    rig.state.files.mkdir()
    rig.now_s += 4.0
    asyncio.run(rig.tick())
    assert len(rig.controller.books.prints[print_id].stills) == 1


def test_stills_are_deleted_with_the_files_of_their_job(rig):
    print_id = rig.run_print()
    asyncio.run(rig.tick())
    (still,) = rig.controller.books.prints[print_id].stills
    rig.controller.handle(
        ev.BedCleared(at_s=300.0, printer="a", by="ann"), ev.JobPruned(at_s=400.0, job=1, by="ann")
    )
    books = rig.controller.books
    assert still.file in list_deletable_files(books) and still.file not in list_referenced_files(books)


def test_hanging_camera_is_cancelled_when_the_daemon_ends(rig):
    async def wait_forever(_):
        await asyncio.Event().wait()

    async def run():
        rig.cameras = Cameras(rig.controller, rig.state, wait_forever, lambda: rig.now_s)
        rig.run_print()
        rig.cameras.tick()
        await asyncio.sleep(0)
        await rig.cameras.close()
        assert len(asyncio.all_tasks()) == 1

    asyncio.run(run())


def test_address_of_a_camera_is_in_no_file_of_the_farm(rig):
    rig.run_print()
    asyncio.run(rig.tick())
    rig.store.close()
    assert all(b"pass-w0rd" not in path.read_bytes() for path in rig.state.root.rglob("*") if path.is_file())
    assert "pass-w0rd" not in json.dumps(rig.controller.fleet.model_dump(mode="json"), default=str)
    assert "pass-w0rd" not in repr(rig.controller.fleet)
