"""Queue of waiting plates by job, in the order in which they are assigned. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from operator import attrgetter

from farm.scheduling.matching import Demand, WaitingPlate

QueueRank = tuple[int, float, int]
"""Sort key of a job in the queue: its negative priority, its rank among jobs of that priority, and its id."""


@dataclass(frozen=True)
class JobPlates:
    """Waiting plates of one job in the order of the queue, with the sets of their properties.

    Instances are cached, because most jobs do not change from one situation to the next.
    """

    plates: tuple[WaitingPlate, ...]

    @classmethod
    def from_plates(cls, plates: Iterable[WaitingPlate]) -> JobPlates:
        """Sort the waiting plates of a job."""
        return cls(tuple(sorted(plates, key=attrgetter("priority_key"))))

    @cached_property
    def queue_rank(self) -> QueueRank:
        """Sort key of the job."""
        return self.plates[0].queue_rank

    @property
    def job(self) -> int:
        """Id of the job."""
        return self.plates[0].job

    @cached_property
    def plate_ids(self) -> frozenset[str]:
        """Ids of the plates."""
        return frozenset({plate.id for plate in self.plates})

    @cached_property
    def planned_printers(self) -> frozenset[str]:
        """Names of the printers for which the plates were planned."""
        return frozenset({plate.planned_printer for plate in self.plates})

    @cached_property
    def demands(self) -> frozenset[Demand]:
        """Distinct demands of the plates."""
        return frozenset({plate.demand for plate in self.plates})

    @cached_property
    def earliest_starts_s(self) -> frozenset[float]:
        """Earliest start times of the plates that have one."""
        return frozenset({plate.not_before_s for plate in self.plates if plate.not_before_s is not None})

    @cached_property
    def reprints(self) -> tuple[WaitingPlate, ...]:
        """Plates that were printed before."""
        return tuple(plate for plate in self.plates if plate.is_reprint)

    @cached_property
    def extra_printer_counts(self) -> dict[int, int]:
        """Number of additional printers that the job may use, by its id; empty for no limit."""
        return {
            plate.job: plate.extra_printer_count
            for plate in self.plates
            if plate.extra_printer_count is not None
        }


@dataclass(frozen=True)
class PlateQueue(Collection[WaitingPlate]):
    """Waiting plates of all jobs, in the order in which they are assigned."""

    jobs: tuple[JobPlates, ...] = ()

    @classmethod
    def from_jobs(cls, jobs: Iterable[JobPlates]) -> PlateQueue:
        """Create a queue from the plates of jobs in any order; jobs without plates are left out."""
        return cls(tuple(sorted((job for job in jobs if job.plates), key=attrgetter("queue_rank"))))

    @classmethod
    def from_plates(cls, plates: Iterable[WaitingPlate]) -> PlateQueue:
        """Create a queue from plates in any order."""
        plates_by_rank: dict[QueueRank, list[WaitingPlate]] = {}
        for plate in plates:
            plates_by_rank.setdefault(plate.queue_rank, []).append(plate)
        return cls.from_jobs(map(JobPlates.from_plates, plates_by_rank.values()))

    def __iter__(self) -> Iterator[WaitingPlate]:
        return chain.from_iterable(job.plates for job in self.jobs)

    def __len__(self) -> int:
        return sum(len(job.plates) for job in self.jobs)

    def __contains__(self, plate: object) -> bool:
        return isinstance(plate, WaitingPlate) and any(plate in job.plates for job in self.jobs)

    def without(self, plates: Collection[str]) -> PlateQueue:
        """Return the queue without the plates with these ids."""
        if not plates:
            return self
        jobs = (
            job
            if job.plate_ids.isdisjoint(plates)
            else JobPlates(tuple(plate for plate in job.plates if plate.id not in plates))
            for job in self.jobs
        )
        return PlateQueue(tuple(job for job in jobs if job.plates))

    def limit_to_rank(self, rank: QueueRank) -> PlateQueue:
        """Return the queue without the jobs after a rank."""
        return PlateQueue(tuple(job for job in self.jobs if job.queue_rank <= rank))

    def list_plates_with_demands(
        self, demands: Collection[Demand]
    ) -> Iterator[tuple[QueueRank, Sequence[WaitingPlate]]]:
        """Yield each job that has plates with these demands: its rank, and those plates."""
        for job in self.jobs:
            if job.demands.issubset(demands):
                yield job.queue_rank, job.plates
            elif not job.demands.isdisjoint(demands):
                yield job.queue_rank, [plate for plate in job.plates if plate.demand in demands]

    @cached_property
    def planned_printers(self) -> frozenset[str]:
        """Names of the printers for which the plates were planned."""
        return frozenset().union(*(job.planned_printers for job in self.jobs))

    @cached_property
    def demands(self) -> frozenset[Demand]:
        """Distinct demands of the plates."""
        return frozenset().union(*(job.demands for job in self.jobs))

    @cached_property
    def earliest_starts_s(self) -> frozenset[float]:
        """Earliest start times of the plates that have one."""
        return frozenset().union(*(job.earliest_starts_s for job in self.jobs))

    @property
    def reprints(self) -> Iterator[WaitingPlate]:
        """Plates that were printed before."""
        return chain.from_iterable(job.reprints for job in self.jobs)

    @property
    def extra_printer_counts(self) -> dict[int, int]:
        """Number of additional printers that each job may use; jobs without a limit are absent."""
        return dict(chain.from_iterable(job.extra_printer_counts.items() for job in self.jobs))
