"""HTTP application of the daemon: all routes, and errors as JSON."""

from __future__ import annotations

from fastapi import Depends, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

import farm
from farm import api
from farm.control import DryRuns, JobCommands, KeyCommands, PartCommands, PrinterCommands
from farm.errors import ErrorCode, ExitCode, FarmError, NotFoundError, RefusedError
from farm.http.body_limit import MAX_BODY_BYTES, TOO_LARGE_STATUS, BodyLimit
from farm.http.callers import identify_caller
from farm.http.routes.events import make_event_routes
from farm.http.routes.files import make_file_routes
from farm.http.routes.hosts import make_host_routes
from farm.http.routes.jobs import make_job_routes, make_part_routes, make_queue_routes
from farm.http.routes.keys import make_key_routes, make_session_routes
from farm.http.routes.printers import make_camera_routes, make_printer_routes
from farm.http.routes.status import make_list_routes, make_status_routes
from farm.http.routes.uploads import make_upload_routes
from farm.http.services import Services
from farm.text import describe_first_error

UPLOAD_PATH = "/jobs"
_STATUS_CODES = {
    ErrorCode.NO_SUCH_THING: 404,
    ErrorCode.REFUSED: 409,
    ErrorCode.FAILED: 500,
    ErrorCode.UNREACHABLE: 503,  # a camera does not answer
}


def make_app(services: Services, dry_runs: DryRuns) -> FastAPI:
    """Make the application with all routes.

    The application serves only the Unix socket: it refuses a request whose caller the kernel has not
    identified.
    """
    app = FastAPI(
        title="farm", version=farm.__version__, openapi_url=None, dependencies=[Depends(identify_caller)]
    )
    add_routes(app, services, dry_runs)
    app.include_router(make_key_routes(services, KeyCommands(services.controller)))
    app.include_router(make_session_routes(services))
    app.add_middleware(BodyLimit, is_upload=UPLOAD_PATH.__eq__)
    return app


def add_routes(app: FastAPI, services: Services, dry_runs: DryRuns, prefix: str = "") -> None:
    """Add the routes of the farm, jobs and printers to an application, with handlers for their errors.

    A request for the status of a job also keeps the job's dry run from being cancelled.
    """
    app.state.controller = services.controller
    printers = PrinterCommands(services.controller)
    parts = PartCommands(services.controller, printers)
    jobs = JobCommands(services.controller, printers)
    for router in (
        make_status_routes(services),
        make_list_routes(services),
        make_event_routes(services),
        make_upload_routes(services, jobs),
        make_job_routes(services, jobs, dry_runs),
        make_queue_routes(services, jobs),
        make_part_routes(parts),
        make_printer_routes(services, printers, parts),
        make_host_routes(services),
        make_camera_routes(services),
        make_file_routes(services),
    ):
        app.include_router(router, prefix=prefix)
    _add_error_handlers(app, services)


def _add_error_handlers(app: FastAPI, services: Services) -> None:
    @app.exception_handler(FarmError)
    async def handle_farm_error(_: Request, error: FarmError) -> Response:
        return make_problem_response(
            str(error), error.code, error.exit_code, _STATUS_CODES.get(error.code, 400)
        )

    @app.exception_handler(RequestValidationError)
    async def handle_invalid_request(_: Request, error: RequestValidationError) -> Response:
        return make_problem_response(
            describe_first_error(error.errors()), ErrorCode.SETTINGS, ExitCode.USAGE, 400
        )

    @app.exception_handler(OSError)
    async def handle_disk_error(_: Request, error: OSError) -> Response:
        root = services.state.root
        text = f"the state folder {root} cannot be used ({error.strerror or error}): check its disk space"
        failure = FarmError(text)
        return make_problem_response(
            text, failure.code, failure.exit_code, _STATUS_CODES.get(failure.code, 400)
        )

    @app.exception_handler(Exception)
    async def handle_unexpected_error(_: Request, error: Exception) -> Response:
        text = f"the daemon failed: {type(error).__name__}: {error}; see its log"
        return make_problem_response(text, ErrorCode.FAILED, ExitCode.FAILED, 500)

    @app.exception_handler(TOO_LARGE_STATUS)
    async def handle_large_body(request: Request, _: Exception) -> Response:
        error = RefusedError(f"the request to {request.url.path} is longer than {MAX_BODY_BYTES // 1024} KiB")
        return make_problem_response(str(error), error.code, error.exit_code, TOO_LARGE_STATUS)

    @app.exception_handler(HTTPException)
    async def handle_other_http_error(_: Request, error: HTTPException) -> Response:
        return make_problem_response(
            str(error.detail), ErrorCode.REFUSED, ExitCode.REFUSED, error.status_code
        )

    @app.exception_handler(404)
    async def handle_not_found(request: Request, _: Exception) -> Response:
        error = NotFoundError(f"there is nothing at {request.url.path}")
        return make_problem_response(str(error), error.code, error.exit_code, 404)


def make_problem_response(text: str, code: ErrorCode, exit_code: ExitCode, status: int) -> Response:
    """Make the response to a request that failed."""
    problem = api.Problem(error=text, code=code, exit_code=int(exit_code))
    return JSONResponse(problem.model_dump(), status_code=status)
