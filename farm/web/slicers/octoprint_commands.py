"""Routes of the OctoPrint API that run commands: select, print, pause and cancel."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request
from pydantic import BaseModel

from farm.control import JobCommands, PartCommands, PrinterCommands
from farm.errors import RefusedError
from farm.http import CallerName, Services, is_operator
from farm.model import PrintState
from farm.web.slicers.address import AddressParameter
from farm.web.slicers.octoprint_views import find_job
from farm.web.slicers.paths import FILE_PATH, JOB_FILE_PATH
from farm.web.slicers.selection import Selection
from farm.web.slicers.text_errors import TextErrorRoute

_NO_CONTENT = 204


class FileCommand(BaseModel):
    """Command on a file: `select`, which also releases the file's held job if `print` is true."""

    command: str
    print: bool = False


class JobCommand(BaseModel):
    """Command on the open print of the addressed printer, or otherwise on the selected job."""

    command: str
    action: Literal["pause", "resume", "toggle"] = "toggle"

    def wants_pause(self, is_paused: bool) -> bool:
        """Return whether the command pauses a print; `toggle` pauses it unless it is paused."""
        return not is_paused if self.action == "toggle" else self.action == "pause"


class ConnectionCommand(BaseModel):
    """Command on the connection to the printer."""

    command: str


def make_octoprint_command_routes(services: Services, jobs: JobCommands, selection: Selection) -> APIRouter:
    """Return the routes of the OctoPrint API that run commands.

    Parameters
    ----------
    services, jobs
        Components of the daemon.
    selection
        Jobs that callers have selected.
    """
    router = APIRouter(route_class=TextErrorRoute, include_in_schema=False)
    controller = services.controller
    printers = PrinterCommands(controller)
    parts = PartCommands(controller, printers)
    _add_file_command_route(router, services, jobs, selection)

    @router.post("/api/job", status_code=_NO_CONTENT)
    async def run_job_command(
        request: Request, body: JobCommand, address: AddressParameter, caller_name: CallerName
    ) -> None:
        job = selection.find(caller_name, address, controller.books)
        if job is None:
            raise RefusedError("no file is selected, and nothing is printing at this address")
        open_print = None if address.printer is None else controller.books.find_open_print(address.printer)
        match body.command:
            case "start":
                await jobs.release(job.id, services.state, caller_name, is_operator(request))
            case "pause" if open_print is not None:
                is_paused = open_print.pause_requested or open_print.state is PrintState.PAUSED
                printers.set_paused(open_print.printer, body.wants_pause(is_paused), caller_name)
            case "pause":
                jobs.set_paused(job.id, body.wants_pause(job.paused), caller_name)
            case "cancel" if open_print is not None:
                parts.cancel_on_printer(open_print.printer, caller_name)
            case "cancel":
                jobs.cancel(job.id, caller_name)
            case _:
                raise RefusedError(f"the farm has no command {body.command} for jobs")

    @router.post("/api/connection", status_code=_NO_CONTENT)
    async def run_connection_command(body: ConnectionCommand, _: AddressParameter) -> None:
        if body.command != "connect":  # a printer's agent connects to it without this command
            raise RefusedError("printers stay connected: `farm maintenance PRINTER` takes one out of use")

    return router


def _add_file_command_route(
    router: APIRouter, services: Services, jobs: JobCommands, selection: Selection
) -> None:
    """Add the route that runs commands on files."""

    @router.post(FILE_PATH, status_code=_NO_CONTENT)
    @router.post(JOB_FILE_PATH, status_code=_NO_CONTENT)
    async def run_file_command(
        request: Request,
        body: FileCommand,
        address: AddressParameter,
        caller_name: CallerName,
        name: str,
        number: str = "",
    ) -> None:
        if body.command != "select":
            raise RefusedError(f"the farm has no command {body.command} for files")
        job = find_job(services.controller.books.jobs, f"{number}/{name}", caller_name)
        if body.print:
            await jobs.release(job.id, services.state, caller_name, is_operator(request))
        selection.select(caller_name, address, job.id)
