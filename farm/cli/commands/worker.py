"""`farm worker`: tasks of farms on this computer, as a part of a Dask cluster."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import os
import socket
from pathlib import Path
from typing import Annotated

import typer

from farm.cli.options import Certificates, parse_scheduler
from farm.errors import Refused

_MOST_SLOTS = 256


def worker(
    scheduler: Annotated[str, typer.Argument(help="Address of the scheduler: tls://HOST:PORT.")],
    certificates: Certificates = None,
    name: Annotated[str | None, typer.Option(help="Name; default: that of this host.")] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Folder for files, of this worker alone; default: the XDG cache.")
    ] = None,
    slots: Annotated[
        int | None,
        typer.Option(min=1, max=_MOST_SLOTS, help="Tasks at the same time; default: one for each core."),
    ] = None,
    memory_gb: Annotated[
        float | None, typer.Option(min=1, help="Memory of each; default: an equal share.")
    ] = None,
) -> None:
    """Run tasks of farms on this computer, as a part of a Dask cluster."""
    from farm.compute.cluster.security import check_cluster

    parse_scheduler(scheduler)
    check_cluster(scheduler, certificates)
    from farm.compute.cluster.serve import WorkerOptions, serve_tasks  # loads Dask
    from farm.planning.tasks import warm

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    name = name or socket.gethostname()
    options = WorkerOptions(
        scheduler,
        certificates,
        name,
        (folder or _default_folder(name)).absolute(),
        slots or len(os.sched_getaffinity(0)),
        memory_gb,
    )
    options.folder.mkdir(parents=True, exist_ok=True)
    with (options.folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Refused(f"another worker uses {options.folder}: give each its own --folder") from None
        asyncio.run(serve_tasks(options, warm))


def _default_folder(name: str) -> Path:
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "farm" / "workers" / name
