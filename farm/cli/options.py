"""Options and arguments shared by several commands."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec

import typer

from decompose.options import FILAMENT_MM, MAX_PIN_MM, MIN_PIN_MM
from farm.cli import completion
from farm.errors import RefusedError
from farm.paths import FarmPaths, find_farm_paths

P = ParamSpec("P")

State = Annotated[Path | None, typer.Option("--state", help="The state folder (FARM_STATE).")]
Socket = Annotated[
    Path | None, typer.Option("--socket", help="The daemon's socket (FARM_SOCKET).", readable=False)
]  # `readable=False`, so that a user without access to it gets the error of the connection
FleetFile = Annotated[Path | None, typer.Option("--fleet", help="The fleet file (FARM_FLEET).")]
Url = Annotated[
    str | None,
    typer.Option("--url", envvar="FARM_URL", show_envvar=False, help="A farm on another host (FARM_URL)."),
]
KeyFile = Annotated[
    Path | None,
    typer.Option(
        "--key-file", envvar="FARM_KEY_FILE", show_envvar=False, help="The key for --url (FARM_KEY_FILE)."
    ),
]
_LOCAL_REASONS = {
    "up": "it starts processes",
    "down": "it stops the farm for all users",
    "key": "a key must not create other keys",
    "web": "the kernel there identifies the user of the link",
    "prune": "deleted files cannot be restored",
}
"""Commands that refuse `--url` and `FARM_URL`, each with the reason."""
_IGNORED_URL_REASONS = {
    "daemon": "it is the server itself",
    "doctor": "it checks this host",
    "discover": "it lists the ports of this host",
    "estop": "it resets the boards by their cables, even if the daemon hangs",
}
"""Commands that refuse `--url` and ignore `FARM_URL`, each with the reason."""
LOCAL_COMMANDS = {**_LOCAL_REASONS, **_IGNORED_URL_REASONS}
"""Commands that work only on the farm's own host, each with the reason."""
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, and nothing else.")]
ReasonOption = Annotated[str, typer.Option(help="The reason; it goes into the history.")]
LongestSide = Annotated[float | None, typer.Option(help="Scale the model to this longest side, mm.")]
Scale = Annotated[
    float | None, typer.Option(help="Scale the model by this factor: 1000 for a model in metres.")
]
Quality = Annotated[str, typer.Option(help="glue, glue-strong, paper, or one of Cura's qualities.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Compute on the cluster of this scheduler, tls://HOST:PORT.")
]
Certificates = Annotated[
    Path | None, typer.Option(help="Folder with ca.pem, cert.pem and key.pem, for a scheduler with TLS.")
]
Pins = Annotated[
    str,
    typer.Option(
        help="Holes for pins in the glued faces: filament (2.85), a diameter in mm, or none. "
        "Not with --quality paper."
    ),
]
PinFit = Annotated[
    float | None,
    typer.Option(
        min=0,
        max=2,
        help="Clearance of a hole around its pin, across the flats, mm; default: that of fleet.yaml, or 0.4.",
    ),
]
Marks = Annotated[
    bool,
    typer.Option(
        "--marks/--no-marks", help="Cut part numbers into the glued faces. Not with --quality paper."
    ),
]
Printer = Annotated[str, typer.Argument(help="The printer.", autocompletion=completion.printers)]
Job = Annotated[int, typer.Argument(help="The job.", autocompletion=completion.jobs)]


def with_paths(command: Callable[Concatenate[FarmPaths, P], None]) -> Callable[P, None]:
    """Add the options `--state`, `--socket` and `--fleet` to a command that works only on the farm's host.

    The command refuses `--url`, and states the reason.

    Parameters
    ----------
    command
        A command that takes the paths named by these options as its first parameter.

    Returns
    -------
    callable
        The command for typer, with the added options after its own.
    """
    variable = "FARM_URL" if command.__name__ in _LOCAL_REASONS else None
    url = Annotated[str | None, typer.Option("--url", envvar=variable, show_envvar=False, hidden=True)]
    key_file = Annotated[Path | None, typer.Option("--key-file", hidden=True)]
    path_options = (("state", State), ("socket", Socket), ("fleet", FleetFile))
    return _add_options(command, (*path_options, ("url", url), ("key_file", key_file)))


def with_farm(command: Callable[Concatenate[FarmPaths, P], None]) -> Callable[P, None]:
    """Add the options of `with_paths` to a command, and `--url` and `--key-file` for farms on other hosts."""
    path_options = (("state", State), ("socket", Socket), ("fleet", FleetFile))
    return _add_options(command, (*path_options, ("url", Url), ("key_file", KeyFile)))


def _add_options(
    command: Callable[Concatenate[FarmPaths, P], None], path_options: Sequence[tuple[str, object]]
) -> Callable[P, None]:
    """Add to a command the options that locate a farm, after the command's own options."""
    signature = inspect.signature(command, eval_str=True)
    options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=option)
        for name, option in path_options
    ]
    parameters = [*list(signature.parameters.values())[1:], *options]

    @functools.wraps(command)
    def run(
        *,
        state: Path | None,
        socket: Path | None,
        fleet: Path | None,
        url: str | None = None,
        key_file: Path | None = None,
        **arguments: Any,
    ) -> None:
        name = command.__name__
        if url is not None and name in LOCAL_COMMANDS:
            raise RefusedError(
                f"farm {name} works only on the farm's own host, as {LOCAL_COMMANDS[name]}: run it there, "
                f"without --url{' or FARM_URL' if name in _LOCAL_REASONS else ''}"
            )
        paths = find_farm_paths(state, socket, fleet)
        command(replace(paths, url=url, key_file=key_file), **arguments)  # type: ignore[call-arg]

    wrapper: Any = run  # typer reads its signature
    wrapper.__signature__ = signature.replace(parameters=parameters)
    wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters} | {
        "return": None
    }
    return run  # type: ignore[return-value]


def parse_pins(text: str) -> float | None:
    """Parse `--pins`.

    Returns
    -------
    float or None
        Diameter of the pins in mm; None for ``none``.

    Raises
    ------
    typer.BadParameter
        If the text is neither ``filament`` nor ``none`` nor a diameter from 1 to 10 mm.
    """
    if text == "none":
        return None
    try:
        pin_mm = FILAMENT_MM if text == "filament" else float(text)
    except ValueError:
        pin_mm = math.nan
    if not MIN_PIN_MM <= pin_mm <= MAX_PIN_MM:
        raise typer.BadParameter(
            f"must be filament, none, or a diameter from {MIN_PIN_MM:g} to {MAX_PIN_MM:g} mm",
            param_hint="--pins",
        )
    return pin_mm


def parse_printer_count(text: str) -> int | None:
    """Parse `--printers`.

    Returns
    -------
    int or None
        The number of printers; None for ``auto``.

    Raises
    ------
    typer.BadParameter
        If the text is neither ``auto`` nor a whole number of at least 1.
    """
    if text == "auto":
        return None
    if not text.isdigit() or int(text) < 1:
        raise typer.BadParameter("must be a whole number of at least 1, or auto", param_hint="--printers")
    return int(text)


def parse_scheduler(text: str) -> str:
    """Return the address of a scheduler if it is valid. Raises typer.BadParameter otherwise."""
    from farm.config import check_scheduler  # slow to load

    try:
        return check_scheduler(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--scheduler") from error
