"""Daemon, which creates and shuts down the clock, store, controller, agents, planner, timers and server."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import gc
import logging
import math
import os
import shutil
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING

import uvicorn
from fastapi import FastAPI

from drivers.clock import Clock
from drivers.log_file import rotate_log
from farm.agents import AgentManager
from farm.cameras import Cameras
from farm.compute import Pool, WorkerPool
from farm.compute.cluster import ClusterPool, connect_cluster
from farm.config import Fleet
from farm.control import (
    Controller,
    DryRuns,
    FarmEffectPerformer,
    Notifier,
    Timers,
    abort_prints,
    delete_record,
)
from farm.errors import FarmError, RefusedError
from farm.http import (
    BoundedServer,
    EventStreams,
    PeerProtocol,
    Services,
    StreamLimit,
    check_operator_group,
    compute_connection_limit,
    listen,
    make_app,
    read_descriptor_limit,
    stop_on_signals,
)
from farm.log_format import start_log
from farm.paths import FarmPaths, StateFolder, read_anchor, write_anchor
from farm.planning import JobPlanner, list_bed_boxes
from farm.planning.error_translation import translate_errors
from farm.planning.replanning import PlateReplanner
from farm.planning.tasks import warm_up_planning
from farm.state.storage import NightlyBackup, open_books
from farm.upkeep.upkeep import Upkeep
from slicing.cache_limit import trim_cache
from slicing.settings import OWN_MATERIALS_VARIABLE

if TYPE_CHECKING:
    from farm.web import NetworkServer

log = logging.getLogger(__name__)

_WATCH_INTERVAL_S = 0.5  # wall seconds; the heaters of a dead agent's printer must be off within 5 s
_TICK_INTERVAL_S = 1.0
_FORECAST_INTERVAL_S = 15.0
_FORECAST_PAUSE_S = 0.02  # pause between two steps of the forecast, for other work of the event loop
_NOTICES_INTERVAL_S = 2.0
_DRY_RUNS_INTERVAL_S = 5.0
_CAMERAS_INTERVAL_S = 0.5
_DISK_INTERVAL_S = 600.0
_LOG_INTERVAL_S = 60.0
_MAX_LOG_BYTES, _MAX_OLD_LOGS = 10 * 2**20, 4
# With Python's default threshold of 700, a view of a large farm (50,000 objects) takes a sixth longer.
_GC_THRESHOLDS = (20_000, 20, 20)
_CLOCK_INTERVAL_S = 1.0  # wall seconds; timers are late by at most this time when the clock is set back
_ABORT_TIMEOUT_S = 150.0  # wall seconds within which every print can be stopped safely
_GRACE_PERIOD_S = 3  # wall seconds for requests that are still running when the daemon ends


class Daemon:
    """Daemon of one farm. `run` returns after `farm down`, or after SIGTERM, which lets prints continue."""

    def __init__(self, fleet: Fleet, paths: FarmPaths) -> None:
        self._fleet = fleet
        self._paths = paths
        self._state = paths.state
        self._clock = open_farm_clock(fleet, self._state)
        self._store, self._restored_s = open_books(self._state, self._clock.now())
        compute = fleet.fleet.compute
        self._workers: Pool = WorkerPool(
            self._state.work / "workers", compute.workers, compute.memory_gb, warm_up_planning
        )
        self._cluster: ClusterPool | None = None
        if compute.scheduler is not None:
            with translate_errors():
                self._cluster = connect_cluster(self._workers, compute.scheduler, compute.certificates)
            self._workers = self._cluster
        controller = self._controller = Controller(fleet, self._store, self._clock, list_bed_boxes)
        self._agents = AgentManager(fleet, self._state, self._clock, controller)
        self._planner = JobPlanner(
            self._state, self._workers, compute.budget_s, controller.on_plan, controller.planning.on_progress
        )
        self._plate_replanner = PlateReplanner(self._state, self._workers, controller.on_replan)
        self._effects = FarmEffectPerformer(
            fleet, self._state, self._clock, self._agents, self._planner, self._plate_replanner
        )
        self._timers = Timers(self._clock)
        self._notifier: Notifier | None = None
        if fleet.fleet.notify:
            urls, name = fleet.fleet.notify, fleet.fleet.name
            self._notifier = Notifier(urls, name, self._state.notices, self._clock.now())
        else:
            delete_record(self._state.notices)
        self._next_change_s: float | None = None  # time at which a timer schedules again
        self._server: uvicorn.Server | None = None
        self._end_task: asyncio.Task[None] | None = None
        self._inspections: dict[Path, str] = {}  # names of the models that are being inspected, by file
        self._streams = EventStreams(self._store)
        self._page_streams = StreamLimit()

    # -- run --------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Serve until the farm is shut down."""
        listener = listen(self._paths.socket, self._fleet.fleet.group)
        upkeep = Upkeep(self._controller, self._store, self._state, self._workers)
        cameras = Cameras(self._controller, self._state)
        services = self._make_services(upkeep, cameras)
        dry_runs = DryRuns(self._controller)
        connection_limit = self._compute_connection_limit()
        self._server = self._make_server(make_app(services, dry_runs), connection_limit)
        self._controller.start(self._effects, self._restored_s)
        books = self._controller.books
        self._agents.start({attempt.printer for attempt in books.list_open_prints()}, books.lost_hosts)
        gc.freeze()  # otherwise each full garbage collection would traverse the state during an event
        gc.set_threshold(*_GC_THRESHOLDS)
        if self._cluster is not None:
            self._cluster.start()
        self._start_timers(dry_runs, cameras)
        clock_task = asyncio.get_running_loop().create_task(self._follow_clock())
        await self._begin_upkeep(upkeep)
        network = self._start_network_server(services, dry_runs, connection_limit)
        try:
            with stop_on_signals(self._server):
                await self._server.serve(sockets=[listener])
        finally:
            clock_task.cancel()
            if network is not None:
                await network.close()
            await cameras.close()
            upkeep.stop()
            await self._stop_components()
            listener.close()
            self._paths.socket.unlink(missing_ok=True)
            self._store.close()

    async def _stop_components(self) -> None:
        """Stop the timers and planning, leave the agents running, and end the workers."""
        self._timers.stop()
        self._planner.stop()
        self._plate_replanner.stop()
        await self._agents.close()
        self._workers.close()
        if self._cluster is not None:
            await self._cluster.wait_closed()

    def _make_services(self, upkeep: Upkeep, cameras: Cameras) -> Services:
        """Make the services of the HTTP interface."""
        return Services(
            self._controller,
            self._state,
            self._paths.fleet,
            self._workers,
            self._shut_down,
            self._agents.replace_agent,
            upkeep.prune,
            cameras.fetch_still,
            self._agents.read_lines,
            inspections=self._inspections,
            streams=self._streams,
            page_streams=self._page_streams,
            cluster=self._cluster,
            hosts=self._agents.hosts,
        )

    def _start_timers(self, dry_runs: DryRuns, cameras: Cameras) -> None:
        """Start the timers of all periodic work."""
        timers = self._timers
        timers.call_every(_WATCH_INTERVAL_S, "watch agents", self._agents.watch)
        timers.call_every(_TICK_INTERVAL_S, "tick", self._schedule)
        timers.call_every(_FORECAST_INTERVAL_S, "forecast", self._renew_forecast)
        timers.call_every(_NOTICES_INTERVAL_S, "notify", self._notify)
        timers.call_every(
            _DRY_RUNS_INTERVAL_S, "dry runs", lambda: dry_runs.cancel_abandoned_runs(time.monotonic())
        )
        timers.call_every(_CAMERAS_INTERVAL_S, "cameras", cameras.tick)
        timers.call_every(
            _LOG_INTERVAL_S, "log", lambda: rotate_log(self._state.log, _MAX_LOG_BYTES, _MAX_OLD_LOGS)
        )
        if self._cluster is not None:
            timers.call_every(_TICK_INTERVAL_S, "cluster", self._warn_about_cluster)
        timers.start()

    def _compute_connection_limit(self) -> int:
        """Compute the maximum number of connections of each server."""
        worker_count = self._fleet.fleet.compute.workers or len(os.sched_getaffinity(0))
        worker_count += 1  # the worker for urgent tasks
        server_count = 1 if self._fleet.web is None else 2
        camera_count = sum(printer.camera is not None for printer in self._fleet.printers)
        device_count = len(self._fleet.printers) + camera_count  # a camera is counted like a printer
        return compute_connection_limit(read_descriptor_limit() // server_count, device_count, worker_count)

    def _make_server(self, app: FastAPI, limit: int) -> BoundedServer:
        """Make the server on the Unix socket."""
        config = uvicorn.Config(
            app,
            http=PeerProtocol,
            log_config=None,
            access_log=False,
            lifespan="off",
            timeout_graceful_shutdown=_GRACE_PERIOD_S,
        )
        return BoundedServer(config, limit, self._stop_work)

    async def _begin_upkeep(self, upkeep: Upkeep) -> None:
        """Finish the deletions of an earlier daemon, and start the nightly backups and the disk checks."""
        upkeep.finish_earlier_deletions()
        self._timers.call_every(_DISK_INTERVAL_S, "disk", upkeep.check_free_space)
        warn = partial(self._controller.warn, "backup")
        await NightlyBackup(
            self._state, self._clock, self._fleet.zone, self._timers.call_at, warn, upkeep.clean_up
        ).begin()

    def _start_network_server(
        self, services: Services, dry_runs: DryRuns, limit: int
    ) -> NetworkServer | None:
        """Start the server for callers on the network, if fleet.yaml has the section `web`."""
        web = self._fleet.web
        if web is None:
            return None
        from farm.web import NetworkServer, find_host_names, has_valid_key, make_web_app  # slow to load

        app = make_web_app(services, dry_runs, find_host_names(web))
        server = NetworkServer(web, app, limit, services.network)
        server.start(lambda: has_valid_key(self._controller.books, self._clock))
        return server

    async def _follow_clock(self) -> None:
        """Follow changes of the host's clock, such as a correction by NTP after a start without a network."""
        while True:
            await asyncio.sleep(_CLOCK_INTERVAL_S)  # on the loop's monotonic clock
            step_s = self._clock.follow_host()
            if step_s:
                log.warning("the host's clock changed by %+.0f s: attended and quiet hours follow it", step_s)
                self._timers.on_clock_set()
                self._agents.hosts.on_clock_set(step_s)
                if self._notifier is not None:
                    self._notifier.on_clock_set(step_s)
                self._controller.on_clock_set(step_s)

    def _notify(self) -> None:
        if self._notifier is not None:
            self._notifier.notify(self._controller.books, self._clock.now())

    def _warn_about_cluster(self) -> None:
        if self._cluster is not None:
            self._controller.warn("compute", "; ".join(self._cluster.state.list_problems()) or None)

    def _schedule(self) -> None:
        """Schedule if the passage of time has changed a decision; set a timer for the next such change."""
        self._controller.tick()
        change_s = self._controller.next_change_s
        if change_s is not None and change_s != self._next_change_s:
            self._timers.call_at(change_s, "next change", self._schedule)
        self._next_change_s = change_s

    async def _renew_forecast(self) -> None:
        for _ in self._controller.forecast.find_background_work() or ():
            await asyncio.sleep(_FORECAST_PAUSE_S)

    async def _shut_down(self, is_immediate: bool) -> None:
        """Begin to shut down: with `is_immediate`, cancel the prints; end the farm once it is idle."""
        self._controller.is_stopping = True
        if is_immediate:
            abort_prints(self._controller)
        self._end_task = asyncio.get_running_loop().create_task(self._end_when_idle(is_immediate))

    def _stop_work(self) -> None:
        """End all streams and all work in workers; requests that wait for this work get an error."""
        self._streams.close()
        self._page_streams.close()
        self._planner.stop()
        self._plate_replanner.stop()
        self._workers.close()

    async def _end_when_idle(self, is_immediate: bool) -> None:
        """Wait for open prints and, unless `is_immediate`, for planning and inspections; then end the farm.

        If a print does not end, the farm keeps running, so that a person can inspect the printer.
        """
        planning = self._controller.planning
        while not is_immediate and (
            self._inspections or planning.list_jobs_in_planning(self._controller.books)
        ):
            await asyncio.sleep(0.1)
        deadline_s = asyncio.get_running_loop().time() + _ABORT_TIMEOUT_S if is_immediate else math.inf
        while printing_printers := sorted(
            {attempt.printer for attempt in self._controller.books.list_open_prints()}
        ):
            if asyncio.get_running_loop().time() > deadline_s:
                log.error(
                    "not shutting down: the prints on %s did not end within %g s",
                    " ".join(printing_printers),
                    _ABORT_TIMEOUT_S,
                )
                self._controller.is_stopping = False
                return
            await asyncio.sleep(0.1)
        await self._agents.shut_down_agents()
        if self._server is not None:
            self._server.should_exit = True


def run(fleet: Fleet, paths: FarmPaths) -> None:
    """Run the daemon in the foreground.

    Raises
    ------
    RefusedError
        If another daemon uses this state folder.
    FarmError
        If the state folder cannot be read or written.
    """
    start_log(fleet.fleet.log)
    logging.getLogger("apscheduler").setLevel(logging.WARNING)
    check_operator_group(fleet.fleet.operators)
    if fleet.fleet.materials is not None:
        os.environ[OWN_MATERIALS_VARIABLE] = str(fleet.fleet.materials)  # the workers inherit it
    paths.state.make()
    try:
        with _lock_state_folder(paths.state):
            _remove_unfinished_files(paths.state)
            asyncio.run(Daemon(fleet, paths).run())
    except OSError as error:
        raise FarmError(
            f"the state folder {paths.state.root} cannot be used ({error}): check its disk space and its "
            "permissions"
        ) from error


def _remove_unfinished_files(state: StateFolder) -> None:
    """Remove the files of tasks that an earlier daemon did not finish."""
    shutil.rmtree(state.work, ignore_errors=True)
    state.make()
    for partial_file in state.slices.glob(".*"):  # files of a worker that was killed while writing them
        partial_file.unlink()
    trim_cache(state.slices)


@contextlib.contextmanager
def _lock_state_folder(state: StateFolder) -> Iterator[None]:
    lock: IO[str] = state.lock.open("a+")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        raise RefusedError(
            f"another daemon (pid {lock.read().strip()}) uses the state folder {state.root}"
        ) from None
    with lock:
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
        yield


def open_farm_clock(fleet: Fleet, state: StateFolder) -> Clock:
    """Open the farm's clock, which continues across restarts, because agents and emulators use it too.

    Raises
    ------
    RefusedError
        If the state folder was used with another time scale.
    """
    scale = fleet.fleet.time_scale
    anchor = read_anchor(state.clock)
    if anchor is None:
        anchor = (scale, time.time())
        write_anchor(state.clock, *anchor)
    if anchor[0] != scale:
        raise RefusedError(
            f"the state folder {state.root} was used with time_scale {anchor[0]:g}, not {scale:g}: "
            "restore the old value in fleet.yaml, or give another folder with --state"
        )
    return Clock(*anchor)
