"""`farm web`: a link that opens the farm's pages in a browser."""

from __future__ import annotations

from typing import Annotated

import typer

from farm.cli.client import Client
from farm.cli.display import print_json
from farm.cli.notices import print_notice
from farm.cli.options import Json, with_paths
from farm.paths import FarmPaths
from farm.text import format_count, format_duration


@with_paths
def web(
    paths: FarmPaths,
    end_all: Annotated[
        bool, typer.Option("--end-all", help="End the sessions of all users instead; for operators.")
    ] = False,
    json: Json = False,
) -> None:
    """Print a link that logs a browser in to the farm's pages; it works once, within five minutes.

    Operators may do everything there; others may do what `farm key add --role print` allows.
    """
    client = Client(paths.socket)
    if end_all:
        response = client.end_sessions()
        if json:
            print_json(response)
        else:
            print(f"{format_count(response.ended, 'session')} ended")
        return
    link = client.make_login_link()
    if json:
        print_json(link)
        return
    print(link.url)
    print_notice(
        f"this link opens the farm as {link.user} ({link.role}), once, within {format_duration(link.valid_s)}"
    )
    if link.url.startswith("http://"):
        print_notice("the link is not encrypted: for other hosts use `web.tls`, a proxy or a VPN")
