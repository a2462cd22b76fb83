"""Address to which a slicer sends its requests: the whole farm, or one of its printers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from farm.config import PrinterSection
from farm.control import Controller
from farm.errors import NotFoundError
from farm.model import Job, JobOptions


@dataclass(frozen=True, slots=True)
class Address:
    """The whole farm, or one of its printers, as the path of a request names it.

    Attributes
    ----------
    printer
        Name of the printer; None for any printer that fits.
    root
        URL up to the path of the slicer's API: scheme, host and prefix, without a trailing slash.
    """

    printer: str | None
    root: str

    @property
    def options(self) -> JobOptions:
        """Options of a job that is submitted at this address."""
        return JobOptions() if self.printer is None else JobOptions(only=(self.printer,))

    def find_name(self, controller: Controller) -> str:
        """Return the name of the printer or of the farm."""
        return self.printer or controller.fleet.fleet.name

    def list_sections(self, controller: Controller) -> list[PrinterSection]:
        """Return the fleet.yaml sections of the printers that may print a job submitted at this address."""
        return [section for section in controller.fleet.printers if self.printer in (None, section.name)]

    def lists_job(self, job: Job) -> bool:
        """Return whether a job is listed at this address."""
        return self.printer is None or not job.options.only or self.printer in job.options.only


def read_address(request: Request) -> Address:
    """Return the address of a request. Raises NotFoundError for an unknown printer."""
    printer: str | None = request.path_params.get("printer")
    controller: Controller = request.app.state.controller
    if printer is not None and printer not in controller.fleet.names:
        printers = ", ".join(sorted(controller.fleet.names)) or "none"
        raise NotFoundError(f"there is no printer {printer}; the fleet has {printers}")
    prefix = "" if printer is None else f"/to/{printer}"
    return Address(printer, f"{request.url.scheme}://{request.url.netloc}{prefix}")


AddressParameter = Annotated[Address, Depends(read_address)]
"""Parameter of a route: the address of the request."""
