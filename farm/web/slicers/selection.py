"""Selected jobs of clients, like the selected file in OctoPrint. They are kept only in memory."""

from __future__ import annotations

from farm.model import Job
from farm.state import Books
from farm.web.slicers.address import Address

_MAX_JOBS = 1000


class Selection:
    """Selected job of each caller at each address."""

    def __init__(self) -> None:
        self._jobs: dict[tuple[str, str | None], int] = {}

    def select(self, caller_name: str, address: Address, job_number: int) -> None:
        """Select a job; if there are too many selections, delete the oldest."""
        self._jobs.pop((caller_name, address.printer), None)
        self._jobs[caller_name, address.printer] = job_number
        if len(self._jobs) > _MAX_JOBS:
            del self._jobs[next(iter(self._jobs))]

    def find(self, caller_name: str, address: Address, books: Books) -> Job | None:
        """Return the job that the printer of an address is printing, or otherwise the selected job."""
        attempt = None if address.printer is None else books.find_open_print(address.printer)
        number = self._jobs.get((caller_name, address.printer)) if attempt is None else attempt.job
        return None if number is None else books.jobs.get(number)
