"""State of a cluster: the place of tasks, and problems that need a person."""

import pytest

from farm.compute.cluster.cluster_state import ClusterState, ClusterWorker, Place, choose_place


@pytest.mark.parametrize(
    ("without_worker_s", "place"),
    [(0.0, Place.CLUSTER), (0.1, Place.WAITING), (29.9, Place.WAITING), (30.0, Place.THIS_COMPUTER)],
)
def test_work_runs_on_this_computer_after_half_a_minute_without_a_worker(without_worker_s, place):
    assert choose_place(without_worker_s) is place


def test_problems_name_the_cluster_and_each_refused_worker():
    worker = ClusterWorker("pc-b", "tls://b:1", 4, "it has farm 2, not 1")
    state = ClusterState("tls://a:8786", Place.THIS_COMPUTER, (worker,), (), 0, 1, 40.0)
    no_cluster, refusal = state.list_problems()
    assert "tls://a:8786" in no_cluster and "running on this computer instead" in no_cluster
    assert refusal == "worker pc-b of the cluster is refused: it has farm 2, not 1"
