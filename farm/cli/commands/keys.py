"""`farm key`: keys for programs and people on other hosts."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Annotated

import typer

from farm import api
from farm.cli.client import Client
from farm.cli.display import Column, lay_out_table, open_console, print_json, read_terminal_width
from farm.cli.notices import print_notice
from farm.cli.options import Json, with_paths
from farm.model import KeyKind, Role
from farm.paths import FarmPaths
from farm.wording import format_time

_COLUMNS = (
    Column("ID"),
    Column("NAME"),
    Column("KIND"),
    Column("ROLE"),
    Column("STATE"),
    Column("LAST USED", rank=1),
    Column("ADDED", rank=2),
)
_DAYS_BY_UNIT = {"d": 1, "w": 7, "y": 365}


class KeyAction(StrEnum):
    """Action of `farm key`."""

    ADD = "add"
    REVOKE = "revoke"
    GRANT = "grant"
    DENY = "deny"


@with_paths
def key(
    paths: FarmPaths,
    action: Annotated[KeyAction | None, typer.Argument(help="The action; default: list the keys.")] = None,
    name: Annotated[
        str | None,
        typer.Argument(
            help="add: name of the person or program; revoke: id of the key; grant, deny: code of the "
            "program that requests a key."
        ),
    ] = None,
    role: Annotated[
        Role, typer.Option(help="look: see everything; print: submit, pause, cancel; operate: all.")
    ] = Role.PRINT,
    expires: Annotated[str | None, typer.Option(help="Time until it expires: 90d, 4w or 1y.")] = None,
    json: Json = False,
) -> None:
    """Add, list and revoke the keys with which programs and people on other computers use the farm; grant or
    deny a program's request for a key (see `web` in fleet.yaml).

    Sessions of browsers (`farm web`) are listed too, and `revoke` ends them by their id. A new key is printed
    only once, on stdout; the farm stores only its hash. Only operators may use this command.
    """
    client = Client(paths.socket)
    if action is None:
        _show_keys(client.fetch_keys(), json)
    elif name is None:
        raise typer.BadParameter(f"farm key {action} needs a name", param_hint="NAME")
    elif action is KeyAction.REVOKE:
        client.revoke_key(name)
        print(f"the key {name} is revoked")
    elif action is KeyAction.GRANT:
        new_key = client.grant_key(name, api.AppKeyGrant(role=role, days=_parse_days(expires)))
        print(f"the program gets the key {new_key.name} ({role})")
    elif action is KeyAction.DENY:
        client.deny_key(name)
        print(f"the program with the code {name} gets no key")
    else:
        _add_key(client, api.KeyRequest(name=name, role=role, days=_parse_days(expires)), json)


def _add_key(client: Client, request: api.KeyRequest, json: bool) -> None:
    new_key = client.add_key(request)
    if json:
        print_json(new_key)
        return
    print(new_key.text)
    print_notice(f"this key for {request.name} ({request.role}) is shown only now; its id is {new_key.id}")
    network = client.fetch_keys().network
    if network.address is None:
        print_notice(
            "the farm does not listen on the network: write `web: {}` into fleet.yaml, then `farm up`"
        )
    elif network.address.startswith("http://") and network.problem is None:
        print_notice(f"{network.address} is not encrypted: for other hosts use `web.tls`, a proxy or a VPN")


def _show_keys(response: api.Keys, json: bool) -> None:
    if json:
        print_json(response)
        return
    network = response.network
    print(f"network: {network.address or 'off'}{f' (closed: {network.problem})' if network.problem else ''}")
    for request in response.requests:
        print(
            f"{request.app} at {request.address} is requesting a key: farm key grant {request.code}, or deny"
        )
    if not response.keys:
        print("there is no key; `farm key add NAME` adds one")
        return
    rows = []
    for key in response.keys:
        end = f"valid until {format_time(key.expires, response.now)}" if key.expires else "valid"
        is_session = key.kind is KeyKind.SESSION
        state = ("ended" if is_session else "revoked") if key.revoked else end if key.valid else "expired"
        created_text, used_text = (format_time(time, response.now) for time in (key.created, key.used))
        rows.append(
            (key.id, key.name, str(key.kind), str(key.role), state, used_text, f"{created_text} by {key.by}")
        )
    screen = open_console()
    for line in lay_out_table(_COLUMNS, rows, read_terminal_width(screen)):
        screen.print(line)


def _parse_days(text: str | None) -> float | None:
    """Parse `--expires`. Raises typer.BadParameter."""
    if text is None:
        return None
    match = re.fullmatch(r"([1-9][0-9]{0,3})([dwy])", text)
    if match is None:
        raise typer.BadParameter("must be a number with d, w or y, like 90d", param_hint="--expires")
    return float(int(match[1]) * _DAYS_BY_UNIT[match[2]])
