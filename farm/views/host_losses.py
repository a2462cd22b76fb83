"""Descriptions of hosts that do not answer: one sentence for all hosts that were lost together. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from farm.config import Fleet
from farm.model import HostLoss, Printer
from farm.state import Books
from farm.text import format_count

_MAX_NAMED_HOSTS = 8


def list_lost_printers(fleet: Fleet, books: Books) -> list[Printer]:
    """List the enabled printers whose host is lost, except those moved to another host since then."""
    entries = ((section, books.get_printer(section.name)) for section in fleet.printers if section.enabled)
    return [entry for section, entry in entries if entry.host_loss and entry.host_loss.host == section.host]


def group_host_losses(books: Books) -> dict[float, list[HostLoss]]:
    """Group the host losses of all printers by time; hosts that were lost together share a time."""
    groups: dict[float, list[HostLoss]] = {}
    for printer in books.printers.values():
        if printer.host_loss is not None:
            groups.setdefault(printer.host_loss.at_s, []).append(printer.host_loss)
    return groups


def describe_lost_hosts(losses: Sequence[HostLoss]) -> str:
    """Describe lost hosts, and what to do, in a sentence; `losses` has one element for each printer."""
    reasons = {loss.host: loss.reason for loss in losses}
    hosts, printers = sorted(reasons), format_count(len(losses), "printer")
    if len(hosts) == 1:
        problem = f"{hosts[0]} with {printers} does not answer ({reasons[hosts[0]]})"
    else:
        problem = f"{len(hosts)} hosts with {printers} do not answer ({_shorten_names(hosts)})"
    pronoun = "its" if len(hosts) == 1 else "their"
    return f"{problem}: prints continue there without the farm; check {pronoun} power and {pronoun} network"


def _shorten_names(hosts: Iterable[str]) -> str:
    """Join the names of hosts; if there are many, name only the first."""
    names = list(hosts)
    hidden_count = len(names) - _MAX_NAMED_HOSTS
    return (
        " ".join(names)
        if hidden_count <= 1
        else f"{' '.join(names[:_MAX_NAMED_HOSTS])} and {hidden_count} more"
    )
