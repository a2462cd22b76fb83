"""One model on a cluster, without a daemon: the same files as on this computer."""

import pytest
import trimesh

from clusters.dask_cluster import INSTALLATION
from clusters.inline_link import InlineLink
from clusters.same_process import SameProcess
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.task_executor import TaskExecutor
from farm.errors import FarmError, RefusedError
from farm.planning.local import on_cluster
from farm.planning.local.on_cluster import Cluster, decompose_on_cluster, slice_on_cluster
from farm.planning.local.slice_file import SliceOptions, slice_to_file

OPTIONS = SliceOptions("ultimaker2_plus", "glue", "generic_pla", 0.4)


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    (tmp_path / "w1").mkdir()

    def connect_worker(local_pool, scheduler, certificates):
        executor = TaskExecutor("w1", tmp_path / "w1", SameProcess(), INSTALLATION)
        return ClusterPool(
            local_pool, scheduler, INSTALLATION, lambda on_workers, _: InlineLink(executor, on_workers)
        )

    monkeypatch.setattr(on_cluster, "connect_cluster", connect_worker)
    return Cluster("tls://a:8786", tmp_path, pytest.fail)


@pytest.fixture
def box(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((20.0, 18.0, 6.0)).export(path)
    return path


def test_slice_on_a_cluster_equals_a_local_one(cluster, box, tmp_path):
    remote_path, local_path = tmp_path / "there" / "box.gcode", tmp_path / "here.gcode"
    report = slice_on_cluster(cluster, box, remote_path, OPTIONS, tmp_path / "cache")
    assert report == slice_to_file(box, local_path, OPTIONS)
    assert remote_path.read_bytes() == local_path.read_bytes()
    # The second slice comes from the cache of the worker.
    assert slice_on_cluster(cluster, box, remote_path, OPTIONS, tmp_path / "cache")["cached"]
    assert not (tmp_path / "cache").exists()


def test_unwritable_output_is_refused_before_any_file_is_sent(cluster, box, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").touch()
    with pytest.raises(RefusedError, match="other files"):
        decompose_on_cluster(cluster, box, tmp_path / "full", None, None)
    with pytest.raises(FarmError, match=r"box\.gcode"):
        slice_on_cluster(cluster, box, box / "box.gcode", OPTIONS, None)
