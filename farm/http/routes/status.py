"""Routes of the whole farm: status, names, history, deletion of old files, and shutdown."""

from __future__ import annotations

from collections import Counter
from typing import Annotated

from fastapi import APIRouter, Query

from farm import api
from farm.compute.cluster import ClusterState, Place, RunningTask
from farm.errors import RefusedError
from farm.http.callers import OperatorName
from farm.http.services import Services
from farm.model import JobState, PrintState
from farm.text import format_count
from farm.views import (
    ViewContext,
    describe_jobs,
    describe_night,
    describe_printer,
    group_waits,
    list_history,
    list_jobs,
    list_prints,
    list_speeds,
    list_tasks,
    select_shown_jobs,
    summarise_jobs,
)


def make_status_routes(services: Services) -> APIRouter:
    """Return the routes of the whole farm."""
    router, controller = APIRouter(), services.controller

    @router.get("/status")
    async def show_status() -> api.Status:
        return describe_farm(services)

    @router.get("/status/summary")
    async def show_status_summary() -> api.StatusSummary:
        return summarise_farm(services)

    @router.get("/names")
    async def list_names() -> api.Names:
        return api.Names(
            printers=list(controller.fleet.names),
            jobs=[
                api.JobName(id=job.id, name=job.name, state=job.state, parts=list(job.parts))
                for job in select_shown_jobs(controller.books)
            ],
        )

    @router.post("/prune")
    async def prune(request: api.PruneRequest, operator_name: OperatorName) -> api.PruneResponse:
        return await services.prune(operator_name, request.dry_run)

    @router.post("/down")
    async def shut_down(request: api.DownRequest, _: OperatorName) -> None:
        if not (request.now or request.wait):
            _check_farm_is_idle(services)
        await services.shut_down(request.now)

    return router


def make_list_routes(services: Services) -> APIRouter:
    """Return the routes that list jobs and prints, including ended ones."""
    router, controller = APIRouter(), services.controller

    @router.get("/history")
    async def show_history(
        job: int | None = None,
        printer: str | None = None,
        last: Annotated[int, Query(ge=1, le=100_000)] = 100,
    ) -> api.History:
        if job is not None:
            controller.books.get_job(job)
        if printer is not None:
            controller.books.get_printer(printer)
        context = controller.build_view_context(services.state)
        prints = list_history(context, job, printer, last)
        now = context.format_time(context.now_s) or ""
        return api.History(now=now, prints=prints, speeds=list_speeds(context, prints))

    @router.get("/prints")
    async def show_prints(
        job: int | None = None,
        printer: str | None = None,
        state: PrintState | None = None,
        last: Annotated[int, Query(ge=1, le=100_000)] = 100,
    ) -> api.Prints:
        context = controller.build_view_context(services.state)
        return api.Prints(
            now=context.format_time(context.now_s) or "",
            prints=list_prints(context, job, printer, state, last),
        )

    @router.get("/jobs")
    async def show_jobs(
        state: JobState | None = None, last: Annotated[int, Query(ge=1, le=100_000)] = 100
    ) -> api.Jobs:
        context = controller.build_view_context(services.state)
        return api.Jobs(now=context.format_time(context.now_s) or "", jobs=list_jobs(context, state, last))

    return router


def _check_farm_is_idle(services: Services) -> None:
    """Raise RefusedError while the farm is printing, planning or checking a submission."""
    books = services.controller.books
    printers = sorted({attempt.printer for attempt in books.list_open_prints()})
    if printers:
        raise RefusedError(
            f"printing: {' '.join(printers)}; use --wait to let them finish, or --now to stop them safely"
        )
    planning_jobs = services.controller.planning.list_jobs_in_planning(books)
    if planning_jobs:
        jobs = " ".join(f"job {number}" for number in planning_jobs)
        raise RefusedError(
            f"being planned: {jobs}; use --wait to finish planning, or --now to plan again after `farm up`"
        )
    models = ", ".join(services.inspections.values())
    if models:
        raise RefusedError(
            f"being checked: {models}; use --wait to finish the checks, or --now to refuse these submissions"
        )


def describe_farm(services: Services) -> api.Status:
    """Describe the whole farm: tasks for people, last night, printers, jobs with their parts and plates."""
    context = services.controller.build_view_context(services.state)
    jobs = describe_jobs(context, select_shown_jobs(context.books))
    return api.Status(**dict(_describe_overview(services, context)), jobs=jobs)


def summarise_farm(services: Services) -> api.StatusSummary:
    """Describe the whole farm for `farm status`, without the parts and plates of jobs."""
    context = services.controller.build_view_context(services.state)
    jobs = select_shown_jobs(context.books)
    return api.StatusSummary(
        **dict(_describe_overview(services, context)),
        jobs=summarise_jobs(context, jobs),
        waits=group_waits(context, jobs),
    )


def _describe_overview(services: Services, context: ViewContext) -> api.FarmOverview:
    """Describe the whole farm without its jobs."""
    controller = services.controller
    fleet = controller.fleet
    reservations = controller.scheduler.list_reservations()
    obstacles = {
        printer.name: printer.find_obstacle() for printer in controller.situations.describe_printers()
    }
    return api.FarmOverview(
        daemon=services.describe_daemon(context),
        todo=list_tasks(context),
        night=describe_night(context),
        fleet=api.FleetView(
            name=fleet.fleet.name,
            timezone=fleet.fleet.timezone,
            time_scale=fleet.fleet.time_scale,
            now=context.format_time(context.now_s) or "",
            forecast=context.forecast_at,
            file=str(services.fleet_file),
        ),
        printers=[
            describe_printer(context, p, obstacles.get(p.name), reservations.get(p.name))
            for p in fleet.printers
        ],
        cluster=None if services.cluster is None else describe_cluster(services.cluster.state),
    )


def describe_cluster(state: ClusterState) -> api.ClusterView:
    """Describe the state of the compute cluster: the tasks, where they run, and why they wait."""
    return api.ClusterView(
        scheduler=state.scheduler,
        place=state.place,
        text=_describe_task_places(state),
        workers=[
            api.ClusterWorkerView(name=worker.name, slots=worker.slot_count, refused=worker.refusal_reason)
            for worker in state.workers
        ],
        tasks=[
            api.ClusterTaskView(what=task.work_name, group=_format_group(task), worker=task.host)
            for task in state.tasks
        ],
        waiting=state.waiting_count,
        here=state.local_count,
    )


def _describe_task_places(state: ClusterState) -> str:
    """Describe in one sentence where tasks run."""
    if state.place is Place.THIS_COMPUTER:
        tasks = f"{state.local_count} now" if state.local_count else "none now"
        place = f"no worker of {state.scheduler} for {state.unusable_s:.0f} s: tasks run on this computer"
        return f"{place}, {tasks}"
    queue_note = f", {format_count(state.waiting_count, 'task')} waiting" if state.waiting_count else ""
    if state.place is Place.WAITING:
        return f"waiting for a worker of {state.scheduler}, {state.unusable_s:.0f} s so far{queue_note}"
    usable_workers = [worker for worker in state.workers if worker.refusal_reason is None]
    counts = Counter(task.host for task in state.tasks if task.host is not None)
    places = ", ".join(f"{host} {count}" for host, count in sorted(counts.items()))
    slots = format_count(sum(worker.slot_count for worker in usable_workers), "slot")
    head = f"{format_count(len(usable_workers), 'worker')} with {slots} on {state.scheduler}"
    unstarted_count = len(state.tasks) - counts.total()
    running_note = f"running: {places}" if places else "nothing is running"
    running_note += f", {format_count(unstarted_count, 'task')} not started" if unstarted_count else ""
    local_note = f", {format_count(state.local_count, 'task')} on this computer" if state.local_count else ""
    return f"{head}; {running_note}{queue_note}{local_note}"


def _format_group(task: RunningTask) -> str | None:
    if isinstance(task.group, int):
        return f"job {task.group}"
    return f"plate {task.group}" if isinstance(task.group, str) else None
