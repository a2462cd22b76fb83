"""Description of a cluster: where its tasks run, and what they wait for."""

from farm.compute.cluster import ClusterState, ClusterWorker, Place, RunningTask
from farm.http.routes.status import describe_cluster

WORKERS = (
    ClusterWorker("pc-b", "tls://b:1", 4),
    ClusterWorker("pc-c", "tls://c:1", 2),
    ClusterWorker("pc-d", "tls://d:1", 8, "it has farm 0, not 1"),
)
TASKS = (
    RunningTask("slicing a part", 3, "pc-b"),
    RunningTask("slicing a part", 3, "pc-b"),
    RunningTask("recutting a part", "4/07", "pc-c"),
    RunningTask("decomposing", 5),
)


def describe_state(place, workers=(), tasks=(), waiting_count=0, local_count=0, unusable_s=0.0):
    return describe_cluster(
        ClusterState("tls://a:8786", place, workers, tasks, waiting_count, local_count, unusable_s)
    )


def test_workers_that_run_tasks_are_named():
    view = describe_state(Place.CLUSTER, WORKERS, TASKS, waiting_count=7)
    assert view.text == (
        "2 workers with 6 slots on tls://a:8786; running: pc-b 2, pc-c 1, 1 task not started, 7 tasks waiting"
    )
    assert [(task.group, task.worker) for task in view.tasks] == [
        ("job 3", "pc-b"),
        ("job 3", "pc-b"),
        ("plate 4/07", "pc-c"),
        ("job 5", None),
    ]
    assert view.workers[2].refused == "it has farm 0, not 1"


def test_lost_cluster_is_described_with_its_duration_and_the_place_of_work():
    assert describe_state(Place.WAITING, waiting_count=1, unusable_s=12.3).text == (
        "waiting for a worker of tls://a:8786, 12 s so far, 1 task waiting"
    )
    assert describe_state(Place.THIS_COMPUTER, local_count=2, unusable_s=31.0).text == (
        "no worker of tls://a:8786 for 31 s: tasks run on this computer, 2 now"
    )
