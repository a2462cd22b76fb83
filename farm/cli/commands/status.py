"""`farm status`: the status page, or the page of one job."""

from __future__ import annotations

import time
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.live import Live

from farm.cli import completion
from farm.cli.client.daemon_client import Client
from farm.cli.display.console import open_console, print_json
from farm.cli.display.job_page import render_job, show_job
from farm.cli.display.progress import retry_over_restart
from farm.cli.display.status_page import render_status
from farm.cli.options import Json, placed
from farm.paths import Places

_REFRESH_S = 1.0


@placed
def status(
    places: Places,
    job: Annotated[int | None, typer.Argument(help="Only this job.", autocompletion=completion.jobs)] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Refresh every second until Ctrl-C.")] = False,
    json: Json = False,
) -> None:
    """Show what you have to do now, the printers, the jobs, and why each waiting plate waits."""
    client = Client(places.socket)
    if watch and not json:
        _watch(client, job)
    elif job is not None:
        answer = client.job(job)
        print_json(answer) if json else show_job(answer.job)
    else:
        whole = client.status()
        screen = open_console()
        print_json(whole) if json else screen.print(render_status(whole, screen.width))


def _watch(client: Client, number: int | None) -> None:
    """Refresh the page every second until Ctrl-C."""
    screen = open_console()

    def draw() -> RenderableType:
        if number is not None:
            return render_job(client.job(number).job)
        return render_status(client.status(), screen.width)

    with Live(retry_over_restart(draw), console=screen, auto_refresh=False, screen=False) as live:
        while True:
            time.sleep(_REFRESH_S)
            live.update(retry_over_restart(draw), refresh=True)
