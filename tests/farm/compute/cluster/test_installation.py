"""Versions of computers, compared by name."""

from dataclasses import replace

import pytest

from farm.compute.cluster.cluster_state import ClusterState, ClusterWorker, Place, choose_place
from farm.compute.cluster.installation import Installation

HERE = Installation("1 (aa)", "4.13.0 (bb)", "cc", "numpy 2.1, scipy 1.17", "/usr/bin/cura", "/cura", "")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, None),
        ({"engine_path": "/opt/cura"}, None),
        ({"farm": "2 (aa)"}, "it has farm 2 (aa), not 1 (aa)"),
        ({"engine": "5.0 (dd)"}, "it has CuraEngine 5.0 (dd), not 4.13.0 (bb)"),
        ({"settings": "ee"}, "it has Cura's settings ee, not cc"),
        ({"libraries": "numpy 2.2, scipy 1.17"}, "it has numpy 2.2, not numpy 2.1"),
    ],
)
def test_a_difference_is_named(changes, reason):
    assert replace(HERE, **changes).describe_difference(HERE) == reason


def test_a_record_of_another_version_of_farm_is_refused():
    other = Installation.from_record({"farm": "0.0.1", "engine_v": "4"})
    assert other.describe_difference(HERE) == "it has farm 0.0.1, not 1 (aa)"
    assert Installation.from_record(HERE.as_record()) == HERE


@pytest.mark.parametrize(
    ("lost_s", "place"),
    [(0.0, Place.CLUSTER), (0.1, Place.WAITING), (29.9, Place.WAITING), (30.0, Place.HERE)],
)
def test_work_runs_here_after_half_a_minute_without_a_worker(lost_s, place):
    assert choose_place(lost_s) is place


def test_problems_name_the_cluster_and_each_refused_worker():
    worker = ClusterWorker("pc-b", "tls://b:1", 4, "it has farm 2, not 1")
    state = ClusterState("tls://a:8786", Place.HERE, (worker,), (), 0, 1, 40.0)
    no_cluster, refused = state.list_problems()
    assert "tls://a:8786" in no_cluster and "this computer computes instead" in no_cluster
    assert refused == "worker pc-b of the cluster is refused: it has farm 2, not 1"
