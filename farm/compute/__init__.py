"""Worker processes, each with limits on time and memory."""

from farm.compute.memory import process_bytes
from farm.compute.worker_pool import CHECKING, DECOMPOSING, SLICING, Limit, Workers

__all__ = [
    "CHECKING",
    "DECOMPOSING",
    "SLICING",
    "Limit",
    "Workers",
    "process_bytes",
]
