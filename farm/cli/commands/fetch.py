"""`farm fetch`: fetch the files of a job from a daemon on this or another host."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from farm.cli.client import connect
from farm.cli.job_files import fetch_files
from farm.cli.notices import print_notice
from farm.cli.options import Job, with_farm
from farm.errors import FarmError
from farm.paths import FarmPaths
from farm.text import format_count

_REPORT_FILE = "report.html"


@with_farm
def fetch(
    paths: FarmPaths,
    job: Job,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="The folder to write to; default: job-N in the current folder."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite existing files whose content differs.")
    ] = False,
) -> None:
    """Fetch the files of a job: parts, G-code, pictures, stills, and a report.

    Each file is verified against its SHA-256, and appears only when it is complete. If the command is run
    again, it fetches only the missing files.
    """
    from farm.cli.job_report import render_report  # slow to load

    client, folder = connect(paths), out or Path(f"job-{job}")
    result = fetch_files(client, job, folder, force)
    present_count = len(result.paths_by_name) - len(result.written_names)
    print(
        f"{folder}: {format_count(len(result.written_names), 'file')} of job {job} fetched"
        + (f", {present_count} already there" if present_count else "")
    )
    report = folder / _REPORT_FILE
    text = render_report(client, job, result.find).text
    try:
        with report.open("w" if force else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        print_notice(f"{report} was kept; --force overwrites it")
    except OSError as error:
        raise FarmError(f"{report} cannot be written ({error.strerror or error})") from error
