"""`farm prune`: delete the files of old jobs, and old events in the database."""

from __future__ import annotations

from typing import Annotated

import typer

from farm import api
from farm.cli.client import Client
from farm.cli.display import print_json
from farm.cli.options import Json, with_paths
from farm.paths import FarmPaths
from farm.text import format_count

_GB = 1e9


@with_paths
def prune(
    paths: FarmPaths,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only list what would be deleted.")] = False,
    json: Json = False,
) -> None:
    """Delete the files of old jobs now instead of at night (see `fleet.keep`); figures and pictures stay.

    The database is backed up first. Files of unfinished jobs, and of jobs that ended in the last two
    days, always stay.
    """
    response = Client(paths.socket).prune(dry_run)
    if json:
        print_json(response)
        return
    for line in describe_prune(response):
        print(line)


def describe_prune(response: api.PruneResponse) -> list[str]:
    """Describe each pruned job on a line, then the totals; for a dry run, what would be deleted."""
    lines = [f"job {job.id}  {job.size_bytes / _GB:.2f} GB  {job.name}" for job in response.jobs]
    jobs = format_count(len(response.jobs), "job")
    verb = "would be pruned" if response.dry_run else "pruned"
    lines.append(
        f"{jobs} {verb}: {response.freed_bytes / _GB:.2f} GB freed, {response.stored_bytes / _GB:.2f} GB kept"
        f", {format_count(response.events, 'old event')} deleted"
    )
    return lines
