"""Execution of a task on a worker of a cluster: files are put into a folder, then a process runs the task."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from farm.compute.cluster.file_cache import FileCache
from farm.compute.cluster.installation import Installation
from farm.compute.cluster.relocation import Relocation, run_relocated
from farm.compute.cluster.remote_task import RemoteAnswer, RemoteTask
from farm.compute.pool import Pool
from slicing.cache_limit import trim_cache

log = logging.getLogger(__name__)

_POLL_INTERVAL_S = 0.5  # wall seconds between two readings of a live file
LiveFileListener = Callable[[str, bytes], None]


class TaskExecutor:
    """Executor of tasks that other computers submit.

    Parameters
    ----------
    host
        Name of this worker.
    folder
        Folder of this worker, for the cache of files, the cache of slices, and a folder for each task.
    pool
        Pool of the processes in which the tasks run.
    installation
        Versions on this computer.
    """

    def __init__(self, host: str, folder: Path, pool: Pool, installation: Installation) -> None:
        self.host, self.installation = host, installation
        self._folder, self._pool = folder, pool
        self._files = FileCache(folder / "files")
        self._tasks_folder = folder / "tasks"
        shutil.rmtree(self._tasks_folder, ignore_errors=True)
        self._tasks_folder.mkdir()

    async def execute(
        self,
        task: RemoteTask,
        contents: Mapping[str, bytes],
        on_live_file: LiveFileListener = lambda *_: None,
    ) -> RemoteAnswer:
        """Run a task. Cancelling the call ends the processes of the task.

        Parameters
        ----------
        task
            The task, with the paths of the submitting computer.
        contents
            Files that were sent with the task, by their hash.
        on_live_file
            Called with the path of a live file on the submitting computer and its new content, whenever it
            changes. Live files are output files that others read while the task runs, such as its progress.
        """
        difference = self.installation.describe_difference(task.installation)
        if difference is not None:
            return RemoteAnswer(self.host, mismatch=difference)
        with self._files.keep_files(task.list_hashes()):
            try:
                for sha256, content in contents.items():
                    await asyncio.to_thread(self._files.store, sha256, content)
            except (OSError, ValueError) as error:
                return RemoteAnswer(self.host, mismatch=str(error))
            missing_hashes = self._files.list_missing_files(task.list_hashes())
            if missing_hashes:
                return RemoteAnswer(self.host, missing_hashes=missing_hashes)
            folder = self._tasks_folder / task.id
            try:
                folder.mkdir()
                return await self._run_task(task, self._place_files(task, folder), on_live_file)
            except OSError as error:  # such as a full disk on this computer
                return RemoteAnswer(self.host, mismatch=str(error))
            except Exception as error:
                return RemoteAnswer(self.host, error=error)
            finally:
                await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)

    def _place_files(self, task: RemoteTask, folder: Path) -> Relocation:
        """Link the input files of a task into its folder; return the mapping of the task's paths."""
        pairs: list[tuple[Path | str, Path | str]] = list(task.installation.pair_paths(self.installation))
        for number, file in enumerate(task.input_files):
            path = folder / f"read-{number}" / Path(file.path).name
            path.parent.mkdir()
            path.hardlink_to(self._files.make_path(file.sha256))
            pairs.append((file.path, path))
        for number, name in enumerate(task.output_folders):
            path = folder / f"folder-{number}"
            path.mkdir()
            pairs.append((name, path))
        for number, name in enumerate(task.output_files):
            path = folder / f"written-{number}" / Path(name).name
            path.parent.mkdir()
            pairs.append((name, path))
        for name in task.cache_folders:
            cache = self._folder / "slices"
            cache.mkdir(exist_ok=True)
            pairs.append((name, cache))
        return Relocation.from_pairs(pairs)

    async def _run_task(
        self, task: RemoteTask, relocation: Relocation, on_live_file: LiveFileListener
    ) -> RemoteAnswer:
        watch_task = asyncio.get_running_loop().create_task(
            _watch_files(task.live_files, relocation, on_live_file)
        )
        try:
            result = await self._pool.run(run_relocated, task.call, relocation, limit=task.limit)
        finally:
            watch_task.cancel()
        files = await asyncio.to_thread(lambda: dict(_collect_files(task, relocation)))
        if task.cache_folders:
            await asyncio.to_thread(trim_cache, self._folder / "slices")
        return RemoteAnswer(self.host, result=result, files=files)


def _collect_files(task: RemoteTask, relocation: Relocation) -> Iterator[tuple[str, bytes]]:
    """Yield the files that a task wrote, with their paths on the submitting computer."""
    for name in task.output_files:
        path = Path(relocation.map_path(name))
        if path.is_file():
            yield name, path.read_bytes()
    for name in task.output_folders:
        folder = Path(relocation.map_path(name))
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.is_symlink():
                yield f"{name}/{path.relative_to(folder)}", path.read_bytes()


async def _watch_files(
    live_files: tuple[str, ...], relocation: Relocation, on_live_file: LiveFileListener
) -> None:
    """Report live files whenever they change."""
    last_contents: dict[str, bytes] = {}
    while live_files:
        await asyncio.sleep(_POLL_INTERVAL_S)
        for name in live_files:
            try:
                content = Path(relocation.map_path(name)).read_bytes()
            except OSError:  # the file is not written yet
                continue
            if last_contents.get(name) != content:
                last_contents[name] = content
                on_live_file(name, content)
