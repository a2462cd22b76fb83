"""`farm decompose` and `farm slice` on a cluster, without a daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from farm.compute import CHECKING_LIMIT, DeferredFunction, Limit, TaskFiles, read_process_memory_bytes
from farm.compute.cluster import connect_cluster
from farm.planning.error_translation import translate_errors
from farm.planning.local.decompose_file import DecomposeRequest, prepare_output_folder
from farm.planning.local.slice_file import SliceOptions, check_output_file

T = TypeVar("T")
_CLUSTER_LIMIT = Limit("working on the cluster", 6 * 3600.0)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Cluster that a command uses.

    Attributes
    ----------
    on_notice
        Called with each message for the user.
    """

    scheduler: str
    certificates: Path | None
    on_notice: Callable[[str], None]


class _LocalPool:
    """Pool that runs work in this process, after the cluster has been abandoned."""

    start_step = None  # text of the current step while workers start: this process is always ready
    has_idle_worker = True

    def __init__(self, on_notice: Callable[[str], None]) -> None:
        self.memory_bytes = read_process_memory_bytes()
        self._on_notice = on_notice

    async def run(
        self, work: Callable[..., T], *args: object, limit: Limit = CHECKING_LIMIT, group: Hashable = None
    ) -> T:
        """Run a function in this process, after a notice to the user."""
        self._on_notice("no cluster worker is usable: running on this computer instead")
        return work(*args)

    def close(self) -> None:
        """Do nothing, because the pool has no processes."""


def decompose_on_cluster(
    cluster: Cluster, path: Path, out: Path, request: DecomposeRequest, cache: Path | None
) -> dict[str, Any]:
    """Cut a model on a cluster; see `decompose_to_folder`."""
    prepare_output_folder(out)
    return _run_on_cluster(cluster, _decompose, path.absolute(), out.absolute(), request, cache)


def slice_on_cluster(
    cluster: Cluster, path: Path, out: Path, options: SliceOptions, cache: Path | None
) -> dict[str, Any]:
    """Slice a model on a cluster; see `slice_to_file`."""
    check_output_file(out, path)
    return _run_on_cluster(cluster, _slice, path.absolute(), out.absolute(), options, cache)


def _run_on_cluster(
    cluster: Cluster, work: DeferredFunction, path: Path, out: Path, *args: object
) -> dict[str, Any]:
    """Run a function on the cluster, or in this process if the cluster cannot be used."""

    local_pool = _LocalPool(cluster.on_notice)
    with translate_errors():
        pool = connect_cluster(local_pool, cluster.scheduler, cluster.certificates)

    async def run() -> dict[str, Any]:
        pool.start()
        try:
            report: dict[str, Any] = await pool.run(work, path, out, *args, limit=_CLUSTER_LIMIT)
            return report
        finally:
            for problem in pool.state.list_problems():
                cluster.on_notice(problem)
            pool.close()
            await pool.wait_closed()

    return asyncio.run(run())


def _list_decompose_files(path: Path, out: Path, _: object, cache: Path | None) -> TaskFiles:
    return TaskFiles(
        input_files=(path,), output_folders=(out,), cache_folders=() if cache is None else (cache,)
    )


def _list_slice_files(path: Path, out: Path, _: object, cache: Path | None) -> TaskFiles:
    return TaskFiles(
        input_files=(path,), output_files=(out,), cache_folders=() if cache is None else (cache,)
    )


_decompose = DeferredFunction("farm.planning.local.decompose_file:decompose_to_folder", _list_decompose_files)
_slice = DeferredFunction("farm.planning.local.slice_file:slice_to_file", _list_slice_files)
