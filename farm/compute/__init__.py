"""Work in processes, each with limits on time and memory: on this computer, or on a cluster."""

from farm.compute.deferred import Deferred, TaskFiles
from farm.compute.limits import CHECKING, DECOMPOSING, DRAWING, SLICING, Limit
from farm.compute.memory import read_process_bytes
from farm.compute.pool import Pool, PoolShare
from farm.compute.worker_pool import Workers

__all__ = [
    "CHECKING",
    "DECOMPOSING",
    "DRAWING",
    "SLICING",
    "Deferred",
    "Limit",
    "Pool",
    "PoolShare",
    "TaskFiles",
    "Workers",
    "read_process_bytes",
]
