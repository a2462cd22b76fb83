"""Jobs that callers have selected, like the selected file in OctoPrint. They are kept only in memory."""

from __future__ import annotations

from farm.model import Job
from farm.state import Books
from farm.web.slicers.address import Address

_MAX_SELECTIONS = 1000


class Selection:
    """Selected job of each caller at each address."""

    def __init__(self) -> None:
        self._job_numbers: dict[tuple[str, str | None], int] = {}  # by the caller's name and the printer

    def select(self, caller_name: str, address: Address, job_number: int) -> None:
        """Select a job; if there are too many selections, delete the oldest."""
        self._job_numbers.pop((caller_name, address.printer), None)
        self._job_numbers[caller_name, address.printer] = job_number
        if len(self._job_numbers) > _MAX_SELECTIONS:
            del self._job_numbers[next(iter(self._job_numbers))]

    def find(self, caller_name: str, address: Address, books: Books) -> Job | None:
        """Return the job that the printer of an address is printing, or otherwise the selected job."""
        attempt = None if address.printer is None else books.find_open_print(address.printer)
        number = self._job_numbers.get((caller_name, address.printer)) if attempt is None else attempt.job
        return None if number is None else books.jobs.get(number)
