"""Shell completion of printers, jobs and parts, with names from the daemon."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from farm.errors import FarmError
from farm.paths import find_farm_paths

if TYPE_CHECKING:
    from farm.api import Names

_TIMEOUT_S = 1.0  # the user is waiting at the prompt
Completions = list[tuple[str, str]]  # words, each with its description
CompletionFunction = Callable[[typer.Context, str], Completions]


def _make_completion(
    list_words: Callable[[Names, typer.Context], Iterable[tuple[str, str]]],
) -> CompletionFunction:
    """Make a completion function for typer from a function that lists all possible words."""

    def complete(context: typer.Context, incomplete: str) -> Completions:
        try:
            names = _fetch_names(context)
        except (OSError, ValueError, FarmError):  # an error message would disturb the prompt
            return []
        return [(word, help_) for word, help_ in list_words(names, context) if word.startswith(incomplete)]

    return complete


def _fetch_names(context: typer.Context) -> Names:
    from farm.cli.client import Client  # slow to load, and only Tab needs it

    state, socket, fleet = (
        Path(path) if (path := context.params.get(name)) else None for name in ("state", "socket", "fleet")
    )
    return Client(find_farm_paths(state, socket, fleet).socket, _TIMEOUT_S, _TIMEOUT_S).fetch_names()


def _list_printers(names: Names, _: typer.Context) -> Completions:
    return [(printer, "") for printer in names.printers]


def _list_jobs(names: Names, _: typer.Context) -> Completions:
    return [(str(job.id), f"{job.name}, {job.state}") for job in names.jobs]


def _list_parts(names: Names, context: typer.Context) -> Completions:
    """List the parts of the job that the command line names, without the number of the job."""
    number = str(context.params.get("job"))
    return [
        (part.rpartition("/")[2], f"of {job.name}")
        for job in names.jobs
        if str(job.id) == number
        for part in job.parts
    ]


def _list_targets(names: Names, context: typer.Context) -> Completions:
    parts = [(part, f"of {job.name}") for job in names.jobs for part in job.parts]
    return [*_list_printers(names, context), *_list_jobs(names, context), *parts]


def _list_beds(names: Names, context: typer.Context) -> Completions:
    return [*_list_printers(names, context), ("all", "all beds that wait to be cleared")]


printers = _make_completion(_list_printers)
jobs = _make_completion(_list_jobs)
parts = _make_completion(_list_parts)
targets = _make_completion(_list_targets)
beds = _make_completion(_list_beds)
