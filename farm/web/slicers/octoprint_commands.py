"""Routes of commands in OctoPrint's interface: select, print, pause and cancel."""

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
from farm.web.slicers.paths import FILE, FILE_OF_JOB
from farm.web.slicers.selection import Selection
from farm.web.slicers.text_errors import TextErrorRoute

_NO_CONTENT = 204


class FileCommand(BaseModel):
    """Command on a file: `select`, which also releases its job if `print` is true."""

    command: str
    print: bool = False


class JobCommand(BaseModel):
    """Command on the selected job or the open print."""

    command: str
    action: Literal["pause", "resume", "toggle"] = "toggle"

    def wants_pause(self, is_paused: bool) -> bool:
        """Return whether the command pauses a print; `toggle` depends on its present state."""
        return not is_paused if self.action == "toggle" else self.action == "pause"


class ConnectionCommand(BaseModel):
    """Command on the connection to the printer."""

    command: str


def make_octoprint_command_routes(services: Services, jobs: JobCommands, selection: Selection) -> APIRouter:
    """Return the routes of commands.

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
    _add_file_command(router, services, jobs, selection)

    @router.post("/api/job", status_code=_NO_CONTENT)
    async def command_job(
        request: Request, body: JobCommand, address: AddressParameter, by: CallerName
    ) -> None:
        job = selection.find(by, address, controller.books)
        if job is None:
            raise RefusedError("no file is selected, and nothing is printing at this address")
        open_print = None if address.printer is None else controller.books.find_open_print(address.printer)
        match body.command:
            case "start":
                await jobs.release(job.id, services.state, by, is_operator(request))
            case "pause" if open_print is not None:
                is_paused = open_print.pause_requested or open_print.state is PrintState.PAUSED
                printers.pause(open_print.printer, body.wants_pause(is_paused), by)
            case "pause":
                jobs.pause(job.id, body.wants_pause(job.paused), by)
            case "cancel" if open_print is not None:
                parts.cancel_on_printer(open_print.printer, by)
            case "cancel":
                jobs.cancel(job.id, by)
            case _:
                raise RefusedError(f"the farm has no command {body.command} for jobs")

    @router.post("/api/connection", status_code=_NO_CONTENT)
    async def command_connection(body: ConnectionCommand, _: AddressParameter) -> None:
        if body.command != "connect":  # agents connect printers without a command
            raise RefusedError("printers stay connected: `farm maintenance PRINTER` takes one out of use")

    return router


def _add_file_command(router: APIRouter, services: Services, jobs: JobCommands, selection: Selection) -> None:
    """Add the route of commands on files."""

    @router.post(FILE, status_code=_NO_CONTENT)
    @router.post(FILE_OF_JOB, status_code=_NO_CONTENT)
    async def command_file(
        request: Request,
        body: FileCommand,
        address: AddressParameter,
        by: CallerName,
        name: str,
        number: str = "",
    ) -> None:
        if body.command != "select":
            raise RefusedError(f"the farm has no command {body.command} for files")
        job = find_job(services.controller.books.jobs, f"{number}/{name}", by)
        if body.print:
            await jobs.release(job.id, services.state, by, is_operator(request))
        selection.select(by, address, job.id)
