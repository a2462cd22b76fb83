"""The ways to agents on other hosts, kept as a printer may leave the fleet before its agent does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from drivers.clock import Clock
from drivers.errors import AgentError
from drivers.records.start_file import Start
from drivers.remote import bridge
from farm.config import PrinterSection

WAY = "way.json"  # in the folder of an agent on another host

Way = tuple[list[str], bytes]
"""The words that start a program which carries bytes to an agent, and what it is told first."""


def _way(section: PrinterSection, farm: str, clock: Clock) -> Way | None:
    """The way to an agent on another host; None where it lives on this one."""
    if section.host is None:
        return None
    start = Start(
        section.name, section.model, section.port, clock.scale, clock.anchor_s, section.power_off_cmd
    )
    errand = bridge.Errand(bridge.Do.SERVE, farm, start)
    return bridge.words(section.host, section.host_command), errand.line()


def reaching(way: Way | None) -> Way | None:
    """The same way to an agent that lives; none is started."""
    if way is None:
        return None
    try:
        errand = bridge.parse(way[1])
    except AgentError:  # an older farm's
        return None
    return way[0], replace(errand, do=bridge.Do.REACH).line()


def kept_way(folder: Path, section: PrinterSection | None, farm: str, clock: Clock) -> Way | None:
    """The way of a printer of the fleet; of one that was taken out while it prints, the one it had."""
    kept = folder / WAY
    if section is None:
        try:
            words, errand = json.loads(kept.read_text())
            return list(map(str, words)), str(errand).encode()
        except (OSError, ValueError, TypeError):
            return None
    way = _way(section, farm, clock)
    if way is None:
        kept.unlink(missing_ok=True)
    else:
        folder.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps((way[0], way[1].decode())))
    return way


def forget(folder: Path) -> None:
    """Nobody is at the end of this way any more."""
    (folder / WAY).unlink(missing_ok=True)
