"""Shell completion of printers, jobs and parts, as the daemon lists them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import closing
from http.client import HTTPException
from pathlib import Path

import typer

from farm.api import Names
from farm.cli.client.unix_http import DaemonConnection
from farm.errors import FarmError
from farm.paths import find_places

_PATIENCE_S = 1.0  # somebody waits at the prompt
Offers = list[tuple[str, str]]  # a word, and what it stands for
Complete = Callable[[typer.Context, str], Offers]


def _offering(words: Callable[[Names, typer.Context], Iterable[tuple[str, str]]]) -> Complete:
    """Make a completion function for typer, which offers the words that begin like the input."""

    def complete(context: typer.Context, incomplete: str) -> Offers:
        try:
            names = _ask(context)
        except (OSError, HTTPException, ValueError, FarmError):  # at a prompt there is nobody to tell
            return []
        return [(word, help_) for word, help_ in words(names, context) if word.startswith(incomplete)]

    return complete


def _ask(context: typer.Context) -> Names:
    state, own, fleet = (
        Path(path) if (path := context.params.get(name)) else None for name in ("state", "socket", "fleet")
    )
    path = find_places(state, own, fleet).socket
    with closing(DaemonConnection(path, _PATIENCE_S, _PATIENCE_S)) as way:
        way.request("GET", "/names")
        return Names.model_validate_json(way.getresponse().read())


def _printers(names: Names, _: typer.Context) -> Offers:
    return [(printer, "") for printer in names.printers]


def _jobs(names: Names, _: typer.Context) -> Offers:
    return [(str(job.id), f"{job.name}, {job.state}") for job in names.jobs]


def _parts(names: Names, context: typer.Context) -> Offers:
    """List the parts of the job given before, without its number."""
    wanted = str(context.params.get("job"))
    return [
        (part.rpartition("/")[2], f"of {job.name}")
        for job in names.jobs
        if str(job.id) == wanted
        for part in job.parts
    ]


def _targets(names: Names, context: typer.Context) -> Offers:
    parts = [(part, f"of {job.name}") for job in names.jobs for part in job.parts]
    return [*_printers(names, context), *_jobs(names, context), *parts]


printers, jobs, parts, targets = map(_offering, (_printers, _jobs, _parts, _targets))
beds = _offering(
    lambda names, context: [*_printers(names, context), ("all", "all beds that wait to be cleared")]
)
