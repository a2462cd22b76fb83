"""Cameras of a fleet: stills for viewers, and stills that are kept with prints.

Stills are fetched in the daemon's event loop. Each fetch is a task for which the controller never waits, even
if the camera does not answer.
"""

from __future__ import annotations

import asyncio
import logging
import time
import uuid
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from farm.cameras.image import CameraError, Image
from farm.cameras.schedule import MAX_INTERVAL_S, MAX_STILL_AGE_S, CameraState, DueStill, find_due_stills
from farm.config import Fleet
from farm.control import Controller
from farm.errors import ErrorCode, FarmError, NotFoundError
from farm.log_format import PrinterLog
from farm.model import Still
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.storage import store_file

log = logging.getLogger(__name__)

_VIEWER_TIMEOUT_S = 10.0  # wall seconds without a viewer after which the last still is dropped from memory

StillFetcher = Callable[[str], Awaitable[Image]]
"""Function that fetches a still from a URL. Raises CameraError."""


async def _fetch_still(url: str) -> Image:
    """Fetch a still. The HTTP client is imported only by the first call, because few farms have cameras."""
    from farm.cameras.fetch import fetch_still

    return await fetch_still(url)


@dataclass(slots=True)
class _Camera:
    """One camera, with its last still and the fetch in progress. Times are monotonic, in seconds."""

    printer: str
    url: str
    state: CameraState = field(default_factory=CameraState)
    latest_still: Image | None = None
    latest_still_s: float = 0.0
    last_viewed_s: float = 0.0
    fetch_task: asyncio.Task[Image] | None = None
    next_store_s: float = 0.0  # earliest time to store a still again after a disk error


class Cameras:
    """Cameras of a fleet.

    Parameters
    ----------
    controller
        The controller, which knows the prints, and records the stills that are stored.
    state
        The state folder, in which stills are stored.
    fetch
        Function that fetches a still from a URL.
    monotonic
        Function that returns the time of a monotonic clock in seconds.
    """

    def __init__(
        self,
        controller: Controller,
        state: StateFolder,
        fetch: StillFetcher = _fetch_still,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._controller, self._state = controller, state
        self._fetch, self._monotonic = fetch, monotonic
        self._cameras = _list_cameras(controller.fleet)
        self._store_tasks: dict[str, asyncio.Task[None]] = {}  # by printer

    def __len__(self) -> int:
        return len(self._cameras)

    async def fetch_still(self, printer: str) -> Image:
        """Return a still that is at most two seconds old.

        Raises
        ------
        NotFoundError
            If there is no such printer, or if it has no camera.
        FarmError
            If the camera has sent no still, or if the last request to it was too recent for another.
        """
        self._controller.books.get_printer(printer)
        camera = self._cameras.get(printer)
        if camera is None:
            raise NotFoundError(f"{printer} has no camera: give its address with `camera` in fleet.yaml")
        now_s = camera.last_viewed_s = self._monotonic()
        if camera.latest_still is not None and now_s - camera.latest_still_s < MAX_STILL_AGE_S:
            return camera.latest_still
        task = camera.fetch_task or self._begin_fetch(camera)
        try:
            if task is None:
                raise CameraError(camera.state.problem or "the last request was too recent")
            return await asyncio.shield(task)
        except CameraError as error:
            raise FarmError(f"the camera of {printer}: {error}", ErrorCode.UNREACHABLE) from None

    def tick(self) -> None:
        """Begin to fetch the stills that are due, and drop from memory the stills that nobody views."""
        now_s = self._monotonic()
        for camera in self._cameras.values():
            if now_s - max(camera.last_viewed_s, camera.latest_still_s) > _VIEWER_TIMEOUT_S:
                camera.latest_still = None
        controller = self._controller
        snapshots, farm_now_s = controller.telemetry.snapshots, controller.clock.now()
        scale, printers = controller.clock.scale, frozenset(self._cameras)
        for due_still in find_due_stills(controller.books, snapshots, printers, farm_now_s, scale):
            camera = self._cameras[due_still.printer]
            if (
                due_still.printer in self._store_tasks
                or camera.fetch_task is not None
                or now_s < camera.next_store_s
            ):
                continue
            task = self._begin_fetch(camera)
            if task is not None:
                store_task = asyncio.get_running_loop().create_task(self._store_still(due_still, task))
                self._store_tasks[due_still.printer] = store_task
                store_task.add_done_callback(partial(self._remove_store_task, due_still.printer))

    def _remove_store_task(self, printer: str, _: asyncio.Task[None]) -> None:
        del self._store_tasks[printer]

    async def close(self) -> None:
        """Cancel all running fetches."""
        fetch_tasks = [
            camera.fetch_task for camera in self._cameras.values() if camera.fetch_task is not None
        ]
        tasks = [*self._store_tasks.values(), *fetch_tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _begin_fetch(self, camera: _Camera) -> asyncio.Task[Image] | None:
        """Begin to fetch a still; return None if the last request was too recent."""
        now_s = self._monotonic()
        if now_s < camera.state.next_attempt_s:
            return None
        camera.state = camera.state.begin(now_s)
        task = camera.fetch_task = asyncio.get_running_loop().create_task(self._run_fetch(camera))
        task.add_done_callback(_consume_error)
        return task

    async def _run_fetch(self, camera: _Camera) -> Image:
        """Fetch a still, and record the outcome. Raises CameraError."""
        previous_problem = camera.state.problem
        try:
            image = await self._fetch(camera.url)
        except CameraError as error:
            camera.state = camera.state.fail(str(error))
            raise
        except Exception as error:  # a library cannot parse the response
            # The message gives only the type of the error, because its text may contain the address.
            camera.state = camera.state.fail(f"its response cannot be read ({type(error).__name__})")
            raise CameraError(camera.state.problem or "") from None
        else:
            camera.state = camera.state.succeed()
            camera.latest_still, camera.latest_still_s = image, self._monotonic()
            return image
        finally:
            camera.fetch_task = None
            problem = camera.state.problem
            if problem is not None and previous_problem is None:
                PrinterLog(log, camera.printer).warning("its camera sends no still: %s", problem)
            elif problem is None and previous_problem is not None:
                PrinterLog(log, camera.printer).info("its camera sends stills again")

    async def _store_still(self, due_still: DueStill, fetch_task: asyncio.Task[Image]) -> None:
        """Store a still, then record it with its print."""
        controller = self._controller
        try:
            image = await fetch_task
            at_s = controller.clock.now()
            name = await asyncio.to_thread(_store_image, self._state, image)
            still = Still(moment=due_still.moment, at_s=at_s, file=name)
            controller.handle(ev.StillKept(at_s=at_s, print_id=due_still.print_id, still=still))
        except CameraError:
            pass  # `_run_fetch` has logged it; a later tick tries again
        except (OSError, FarmError) as error:
            self._cameras[due_still.printer].next_store_s = self._monotonic() + MAX_INTERVAL_S
            PrinterLog(log, due_still.printer).warning("a still cannot be stored: %s", error)


def _list_cameras(fleet: Fleet) -> dict[str, _Camera]:
    return {
        printer.name: _Camera(printer.name, url)
        for printer in fleet.printers
        if (url := printer.camera_url) is not None
    }


def _store_image(state: StateFolder, image: Image) -> str:
    """Store an image, and return the name of its file in the store. Raises OSError."""
    path: Path = state.work / f"still-{uuid.uuid4().hex}{image.suffix}"
    try:
        path.write_bytes(image.content)
        return store_file(state.files, path)
    finally:
        path.unlink(missing_ok=True)


def _consume_error(task: asyncio.Task[Image]) -> None:
    """Read the error of a fetch for which nobody waits, because asyncio logs errors that are never read."""
    if not task.cancelled():
        task.exception()
