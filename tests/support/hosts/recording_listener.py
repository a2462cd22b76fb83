"""Listener of agents and hosts that stores what they report."""

from collections import defaultdict
from collections.abc import Collection, Sequence

from farm.model import AgentPrint, AgentSnapshot, Link, PrintState
from farm.state import events as ev


class RecordingListener:
    """Listener that stores snapshots, refusals, events and warnings.

    Attributes
    ----------
    last_snapshot, last_snapshots
        Last snapshot of any printer, and of each.
    print_states
        States of the print in all snapshots of a printer.
    refusals
        Each refused print, and whether the refusal is late.
    """

    def __init__(self, *, allows_refusals: bool = False) -> None:
        self._allows_refusals = allows_refusals
        self.last_snapshot: AgentSnapshot | None = None
        self.last_snapshots: dict[str, AgentSnapshot] = {}
        self.print_states: defaultdict[str, list[PrintState]] = defaultdict(list)
        self.refusals: list[tuple[str, bool]] = []
        self.events: list[ev.AnyEvent] = []
        self.warnings: dict[str, str | None] = {}

    def on_snapshot(self, snapshot: AgentSnapshot) -> None:
        self.last_snapshot = self.last_snapshots[snapshot.printer] = snapshot
        if snapshot.print is not None:
            self.print_states[snapshot.printer].append(snapshot.print.state)

    def on_refusal(self, print_id: str, reason: str, is_late: bool) -> None:
        assert self._allows_refusals, reason
        self.refusals.append((print_id, is_late))

    def find_unreported_since_s(self, printer: str) -> float | None:
        return None

    def on_journal(self, snapshot: AgentSnapshot, prints: Sequence[AgentPrint]) -> None:
        raise AssertionError(prints)

    def handle(self, *events: ev.AnyEvent) -> None:
        self.events += events

    def warn(self, topic: str, text: str | None) -> None:
        self.warnings[topic] = text

    def is_host_connected(self, host: str) -> bool:
        """Check that a host has no event, or that its last event is a connection."""
        kinds = [type(event) for event in self.events if getattr(event, "host", None) == host]
        return kinds[-1:] in ([], [ev.HostConnected])

    def list_links(self, printers: Collection[str]) -> set[Link]:
        """List the states of the links of some printers."""
        return {
            self.last_snapshots[name].link if name in self.last_snapshots else Link.STARTING
            for name in printers
        }
