"""Options that commands share: where the farm is, which printer, and in what form to answer."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec

import typer

from farm.cli import completion
from farm.paths import Places, find_places

P = ParamSpec("P")

State = Annotated[Path | None, typer.Option("--state", help="The state folder (FARM_STATE).")]
Socket = Annotated[
    Path | None, typer.Option("--socket", help="The daemon's socket (FARM_SOCKET).", readable=False)
]  # who may not use it is told so by whoever connects
FleetFile = Annotated[Path | None, typer.Option("--fleet", help="The fleet file (FARM_FLEET).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, and nothing else.")]
Why = Annotated[str, typer.Option(help="What you saw; it goes into the history.")]
Printer = Annotated[str, typer.Argument(help="The printer.", autocompletion=completion.printers)]
Job = Annotated[int, typer.Argument(help="The job.", autocompletion=completion.jobs)]


def placed(command: Callable[Concatenate[Places, P], None]) -> Callable[P, None]:
    """A command that takes `--state`, `--socket` and `--fleet`, and gets the places that they name."""
    own = inspect.signature(command, eval_str=True)
    options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=option)
        for name, option in (("state", State), ("socket", Socket), ("fleet", FleetFile))
    ]
    parameters = [*list(own.parameters.values())[1:], *options]

    @functools.wraps(command)
    def run(*, state: Path | None, socket: Path | None, fleet: Path | None, **given: Any) -> None:
        command(find_places(state, socket, fleet), **given)  # type: ignore[call-arg]

    seen: Any = run  # what typer reads
    seen.__signature__ = own.replace(parameters=parameters)
    seen.__annotations__ = {one.name: one.annotation for one in parameters} | {"return": None}
    return run  # type: ignore[return-value]
