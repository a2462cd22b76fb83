"""Work on a cluster with Dask's `distributed`, without a shared disk: files are sent, named by their SHA-256.

Only `connection`, `dask_worker` and `make_security` import `distributed`, and only if a cluster is used.
"""

from farm.compute.cluster.cluster_pool import ClusterPool, connect_cluster
from farm.compute.cluster.cluster_state import ClusterState, ClusterWorker, Place, RunningTask

__all__ = [
    "ClusterPool",
    "ClusterState",
    "ClusterWorker",
    "Place",
    "RunningTask",
    "connect_cluster",
]
