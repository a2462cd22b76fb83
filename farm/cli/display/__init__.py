"""Pages, tables and progress on the terminal."""

from __future__ import annotations

from farm.cli.display.console import open_console, print_json, read_terminal_width
from farm.cli.display.job_page import render_job, show_job, show_result, show_submitted_job
from farm.cli.display.progress import follow_job, retry_during_restart, show_progress, show_upload
from farm.cli.display.status_page import render_status
from farm.cli.display.table import Column, lay_out_table
from farm.cli.display.timeline import show_timeline

__all__ = [
    "Column",
    "follow_job",
    "lay_out_table",
    "open_console",
    "print_json",
    "read_terminal_width",
    "render_job",
    "render_status",
    "retry_during_restart",
    "show_job",
    "show_progress",
    "show_result",
    "show_submitted_job",
    "show_timeline",
    "show_upload",
]
