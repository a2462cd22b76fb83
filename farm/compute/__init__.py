"""Worker processes, each with limits on time and memory."""

from farm.compute.memory import read_process_bytes
from farm.compute.worker_pool import CHECKING, DECOMPOSING, SLICING, Limit, Workers, WorkerShare

__all__ = [
    "CHECKING",
    "DECOMPOSING",
    "SLICING",
    "Limit",
    "WorkerShare",
    "Workers",
    "read_process_bytes",
]
