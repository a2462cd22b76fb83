"""The daemon's HTTP interface: requests in, `Core` called, views out. Nothing here decides anything."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from fastapi import FastAPI, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

import farm
from farm import api
from farm.compute.worker_pool import Workers
from farm.control.approval import Ahead, add_ahead
from farm.control.controller import Core
from farm.control.dry_runs import DryRuns
from farm.control.print_commands import Desk, add_desk
from farm.errors import ErrorCode, ExitCode, FarmError, NoSuchThing, Refused
from farm.http.callers import By, ByOperator
from farm.model import JobOptions
from farm.paths import StateFolder
from farm.planning.tasks import inspect_submission
from farm.scheduling.time_expressions import start_and_deadline_s
from farm.text import first_of, one_line
from farm.views.context import ViewContext
from farm.views.history import describe_night, list_history, select_shown_jobs
from farm.views.jobs import describe_job
from farm.views.printers import describe_printer
from farm.views.tasks import list_tasks

_STATUS = {ErrorCode.NO_SUCH_THING: 404, ErrorCode.REFUSED: 409, ErrorCode.FAILED: 500}
_LARGEST_MODEL = 2 * 1024**3  # bytes

_LONGEST_NAME = 60  # characters, so that it can be a file's name too


def display_name(name: str) -> str:
    """What a model is called, never where it lies: printable, on one line, fit for a file's name."""
    last = name.replace("\\", "/").rpartition("/")[2]
    plain = one_line(last).lstrip(".")
    return plain[-_LONGEST_NAME:] or "model"


Down = Callable[[bool], Awaitable[None]]
Replace = Callable[[str], Awaitable[None]]


async def no_agents(name: str) -> None:
    """Where there are none to replace."""
    raise Refused(f"{name} has no agent")


def make_app(
    core: Core,
    state: StateFolder,
    fleet_file: Path,
    since_s: float,
    workers: Workers,
    down: Down,
    replace: Replace = no_agents,
) -> FastAPI:
    """The application; `down(now)` ends the farm, `replace(printer)` the agent of an idle printer."""
    app = FastAPI(title="farm", version=farm.__version__)
    app.state.core = core
    app.state.dry_runs = DryRuns(core)
    desk = Desk(core)

    def daemon(context: ViewContext) -> api.DaemonView:
        return api.DaemonView(
            pid=os.getpid(), version=farm.__version__, since=context.format_time(since_s) or ""
        )

    @app.exception_handler(FarmError)
    async def refused(_: Request, error: FarmError) -> Response:
        problem = api.Problem(error=str(error), code=error.code, exit_code=int(error.exit_code))
        return JSONResponse(problem.model_dump(), status_code=_STATUS.get(error.code, 400))

    @app.exception_handler(RequestValidationError)
    async def misused(_: Request, error: RequestValidationError) -> Response:
        said = first_of(error.errors())
        problem = api.Problem(error=said, code=ErrorCode.SETTINGS, exit_code=int(ExitCode.USAGE))
        return JSONResponse(problem.model_dump(), status_code=400)

    @app.get("/status")
    async def status() -> api.Status:
        context = core.build_view_context(state)
        obstacles = {view.name: view.obstacle() for view in core.fleet_printers()}
        return api.Status(
            daemon=daemon(context),
            todo=list_tasks(context),
            night=describe_night(context),
            fleet=api.FleetView(
                name=core.fleet.fleet.name,
                timezone=core.fleet.fleet.timezone,
                time_scale=core.fleet.fleet.time_scale,
                now=context.format_time(context.now_s) or "",
                file=str(fleet_file),
            ),
            printers=[describe_printer(context, p, obstacles.get(p.name)) for p in core.fleet.printers],
            jobs=[describe_job(context, job) for job in select_shown_jobs(core.books)],
        )

    @app.get("/names")
    async def names() -> api.Names:
        return api.Names(
            printers=list(core.fleet.names),
            jobs=[
                api.JobName(id=job.id, name=job.name, state=job.state, parts=list(job.parts))
                for job in select_shown_jobs(core.books)
            ],
        )

    @app.get("/history")
    async def past(
        job: int | None = None,
        printer: str | None = None,
        last: Annotated[int, Query(ge=1, le=100_000)] = 100,
    ) -> api.History:
        if job is not None:
            core.books.job(job)
        if printer is not None:
            core.books.printer(printer)
        return api.History(prints=list_history(core.build_view_context(state), job, printer, last))

    @app.get("/jobs/{number}")
    async def job(number: int) -> api.JobStatus:
        app.state.dry_runs.asked(number, time.monotonic())
        context = core.build_view_context(state)
        return api.JobStatus(daemon=daemon(context), job=describe_job(context, core.books.job(number)))

    @app.post("/jobs")
    async def submit(
        request: Request,
        request_id: Annotated[str, Query(min_length=8, max_length=64)],
        name: Annotated[str, Query(min_length=1, max_length=200)],
        size: Annotated[int, Query(ge=0, le=_LARGEST_MODEL)],
        by: By,
        options: str = "{}",
    ) -> api.Submitted:
        name = display_name(name)
        try:
            wanted = JobOptions.model_validate_json(options)
        except ValidationError as error:
            raise FarmError(f"bad options: {error.errors()[0]['msg']}", ErrorCode.SETTINGS) from error
        known = core.submitted(request_id)
        if known is not None:
            return api.Submitted(job=known, again=True)
        start_and_deadline_s(
            wanted, core.rules, core.clock.now()
        )  # what it says wrongly is said before the upload
        if core.stopping:
            raise Refused("the farm is going down: submit again when it is up")
        upload = state.work / f"upload-{uuid.uuid4().hex}"
        try:
            received = 0
            with upload.open("wb") as file, suppress(ClientDisconnect):  # what came is too little then
                async for chunk in request.stream():
                    received += len(chunk)
                    if received > size:
                        break
                    file.write(chunk)
            if received != size:
                raise Refused(
                    f"the upload of {name} was cut: {received} of {size} bytes came; submit it again"
                )
            model = await workers.run(
                inspect_submission, upload, name, wanted, core.fleet.printers, state.files
            )
        finally:
            upload.unlink(missing_ok=True)
        number, again = core.submit(request_id, name, model, wanted, by)
        return api.Submitted(job=number, again=again)

    @app.post("/jobs/{number}/cancel")
    async def cancel(number: int, by: By) -> api.JobStatus:
        desk.cancel_job(number, by)
        return await job(number)

    @app.post("/printers/{name}/replace")
    async def replace_agent(name: str, by: ByOperator) -> None:
        if core.books.open_print_on(name) is not None:
            raise Refused(f"{name} prints: its agent can be replaced when that has ended")
        await replace(name)

    add_desk(app, desk)
    add_ahead(app, Ahead(core, state))

    @app.post("/down")
    async def go_down(request: api.DownRequest, _: ByOperator) -> None:
        busy = sorted({attempt.printer for attempt in core.books.open_prints()})
        if busy and not (request.now or request.wait):
            raise Refused(f"printing: {' '.join(busy)}; use --wait, or --now to end everything safely")
        await down(request.now)

    @app.exception_handler(OSError)
    async def no_room(request: Request, error: OSError) -> Response:
        said = f"the state folder {state.root} cannot be used ({error.strerror or error}): has its disk room?"
        return await refused(request, FarmError(said))

    @app.exception_handler(Exception)
    async def broken(_: Request, error: Exception) -> Response:
        problem = api.Problem(
            error=f"the daemon failed: {type(error).__name__}: {error}; see its log",
            code=ErrorCode.FAILED,
            exit_code=int(ExitCode.FAILED),
        )
        return JSONResponse(problem.model_dump(), status_code=500)

    @app.exception_handler(404)
    async def unknown(request: Request, _: Exception) -> Response:
        error = NoSuchThing(f"there is nothing at {request.url.path}")
        problem = api.Problem(error=str(error), code=error.code, exit_code=int(error.exit_code))
        return JSONResponse(problem.model_dump(), status_code=404)

    return app
