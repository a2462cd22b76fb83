"""Calls of functions by benches, on this computer or on a cluster."""

import pickle
import pkgutil
from argparse import ArgumentParser

import pytest

from bench import decompose, unseen
from bench.clusters import calls
from bench.clusters.calls import add_cluster_options, count_calls, open_calls
from bench.prices import savings
from clusters import portable_work as work
from clusters.dask_cluster import INSTALLATION
from clusters.inline_link import InlineLink
from clusters.same_process import SameProcess
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.task_executor import TaskExecutor
from farm.errors import FarmError


@pytest.mark.parametrize(
    "work",
    [
        decompose.deferred_cut,
        decompose.deferred_rebalance,
        savings.deferred_measure,
        unseen.deferred_measure,
    ],
)
def test_functions_of_benches_can_be_sent_to_other_processes(work):
    """Check that every process can find the functions by their names."""
    assert pickle.loads(pickle.dumps(work)) == work
    assert callable(pkgutil.resolve_name(work.target))


def parse_options(*args):
    parser = ArgumentParser()
    add_cluster_options(parser)
    return parser.parse_args(args)


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "model.stl"
    path.write_bytes(b"solid")
    return path


def test_calls_are_made_locally_without_a_scheduler(tmp_path, source):
    with open_calls(parse_options()) as call:
        assert call(work.copy, source, tmp_path / "out")["copy"].read_bytes() == b"solid"
    with open_calls(parse_options(), local_call=lambda function, *args: args) as call:
        assert call(work.copy, 1, 2) == (1, 2)
    assert count_calls(parse_options(), 3) == 3


def test_calls_run_on_the_cluster_with_their_files_and_errors(tmp_path, source, monkeypatch):
    executor = TaskExecutor("w1", tmp_path, SameProcess(), INSTALLATION)
    requests = []

    def connect(local_pool, scheduler, certificates):
        requests.append((scheduler, certificates))
        return ClusterPool(
            local_pool, scheduler, INSTALLATION, lambda on_workers, _: InlineLink(executor, on_workers)
        )

    class InlineWorkers(SameProcess):
        def __init__(self, *_):
            pass

        def close(self):
            pass

    monkeypatch.setattr(calls, "connect_cluster", connect)
    monkeypatch.setattr(calls, "WorkerPool", InlineWorkers)
    args = parse_options("--scheduler", "tls://a:8786", "--certificates", str(tmp_path))
    with open_calls(args) as call:
        assert call(work.copy, source, tmp_path / "out")["copy"] == tmp_path / "out" / "copy.txt"
        with pytest.raises(FarmError, match="this model is hollow"):
            call(work.fail, source, tmp_path / "out")
    assert (tmp_path / "out" / "copy.txt").read_bytes() == b"solid"
    assert requests == [("tls://a:8786", tmp_path)] and count_calls(args, 3) > 3
    assert list((tmp_path / "files").iterdir())  # the worker has received the file
