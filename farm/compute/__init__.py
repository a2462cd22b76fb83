"""Work in processes on this computer or on a cluster, with limits on time and memory."""

from farm.compute.deferred import DeferredFunction, TaskFiles
from farm.compute.limits import CHECKING_LIMIT, DECOMPOSING_LIMIT, DRAWING_LIMIT, SLICING_LIMIT, Limit
from farm.compute.memory import read_process_memory_bytes
from farm.compute.pool import Pool, PoolShare
from farm.compute.worker_pool import WorkerPool

__all__ = [
    "CHECKING_LIMIT",
    "DECOMPOSING_LIMIT",
    "DRAWING_LIMIT",
    "SLICING_LIMIT",
    "DeferredFunction",
    "Limit",
    "Pool",
    "PoolShare",
    "TaskFiles",
    "WorkerPool",
    "read_process_memory_bytes",
]
