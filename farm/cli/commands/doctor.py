"""`farm doctor`: checks of the installation, with what to do."""

from __future__ import annotations

import typer

from farm.cli.client.daemon_client import Client
from farm.cli.display.console import print_json
from farm.cli.options import Json, placed
from farm.errors import ExitCode, FarmError
from farm.paths import Places

_SCHEMA = 1


@placed
def doctor(places: Places, json: Json = False) -> None:
    """Check database, files, agents, ports, CuraEngine, clock and disks, and say what to do.

    It ends with 1 where there is a problem; warnings alone are no problem.
    """
    from farm.doctor import Level, check_installation, collect_facts  # slow to load

    version = error = None
    try:
        version = Client(places.socket).status().daemon.version
    except FarmError as trouble:
        error = str(trouble)
    findings = check_installation(collect_facts(places, version, error))
    if json:
        found = [
            {"check": one.check, "level": str(one.level), "text": one.text, "action": one.action}
            for one in findings
        ]
        print_json({"schema": _SCHEMA, "findings": found})
    else:
        for one in findings:
            print(f"{one.level:<8} {one.check}: {one.text}{f'; {one.action}' if one.action else ''}")
    if any(one.level is Level.PROBLEM for one in findings):
        raise typer.Exit(ExitCode.FAILED)
