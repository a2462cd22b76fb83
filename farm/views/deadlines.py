"""Tasks with a deadline: paused prints, and prints that outlast the attended hours. Pure."""

from __future__ import annotations

import math
from datetime import datetime, tzinfo

from farm import api
from farm.model import AgentPrint, Print, PrintState


def list_deadlines(
    attempt: Print, said: AgentPrint | None, remaining_s: float, now_s: float, zone: tzinfo
) -> list[api.Todo]:
    """List what has to be done before a print is ended: resume it, or extend the attended hours.

    Parameters
    ----------
    attempt, said
        An open print, and the latest that its agent said of it.
    remaining_s
        What it would take from `now_s` on.
    zone
        Of the moments in the texts.
    """
    if said is None or attempt.state is PrintState.ENDING:
        return []

    def words(at_s: float) -> str:
        return datetime.fromtimestamp(at_s, zone).strftime("%a %H:%M")

    name, found = attempt.printer, []
    hours_s = math.inf if said.ends_by_s is None else said.ends_by_s
    if attempt.state is PrintState.PAUSED and attempt.pause_requested and said.pause_ends_s is not None:
        by = words(min(said.pause_ends_s, hours_s))  # nothing while it parks, or goes on already
        text = f"resume {name} by {by}, or its print will be ended: `farm resume {name}`"
        found.append(api.Todo(code="resume", printers=[name], text=text))
    if now_s + remaining_s > hours_s:
        what = f"{name} needs until {words(now_s + remaining_s)}, but its print ends at {words(hours_s)}"
        text = (
            f"{what}, when the attended hours end: if somebody stays, extend `attended` in "
            "fleet.yaml and restart the daemon"
        )
        found.append(api.Todo(code="hours", printers=[name], text=text, brief=what))
    return found
