"""Data of hosts for `farm hosts`."""

from pathlib import Path

from drivers.host import AgentPhase, AgentState, HostState, PortState
from farm.agents import HostRecord
from farm.config import Fleet
from farm.http.routes.hosts import describe_host
from farm.model import AgentSnapshot, Bed, Link, Printer
from farm.paths import StateFolder
from farm.state import Books
from farm.state.books import put
from farm.views import ViewContext, describe_printer, list_tasks


def make_context(snapshots=None):
    rows = [
        {"name": name, "model": "ultimaker2_plus", "port": f"/dev/{name}", "host": "pc-b"} for name in "ab"
    ]
    books = put(Books(), *(Printer(name=name, bed=Bed.CLEAR) for name in "ab"))
    fleet = Fleet.model_validate({"printers": rows})
    return ViewContext(fleet, books, snapshots or {}, StateFolder(Path("/state")), 1000.0)


def test_host_is_described_with_its_agents_ports_and_wait():
    record = HostRecord("pc-b", ("a", "b"), 900.0)
    view = describe_host(make_context(), record)
    assert view.connected is None and view.lost and view.waiting == "a connection: it has not answered yet"
    agents = (
        AgentState(printer="a", phase=AgentPhase.PRINTING, pid=7),
        AgentState(printer="b", phase=AgentPhase.WAITING, restarts=3, reason="its agent ended with 1"),
    )
    ports = (PortState(port="/dev/a", description="UM2", printer="a"),)
    record.on_state(950.0, HostState(pid=3, version="1.2", agents=agents, ports=ports))
    view = describe_host(make_context(), record)
    assert view.lost is None and view.connected and view.version == "1.2" and view.update == "current"
    assert [(agent.printer, agent.state, agent.pid, agent.restarts) for agent in view.agents] == [
        ("a", "printing", 7, 0),
        ("b", "waiting", None, 3),
    ]
    assert view.ports[0].printer == "a"
    assert view.waiting == "agents that have to start again: b (its agent ended with 1)"


def test_printers_of_a_lost_host_are_unknown_and_have_no_tasks_of_their_own():
    reason = "no connection to its host pc-b: no route"
    lost_snapshot = AgentSnapshot(printer="a", link=Link.STARTING, reason=reason, host_lost=True)
    context = make_context({"a": lost_snapshot, "b": AgentSnapshot(printer="b", link=Link.STARTING)})
    first_view, second_view = (describe_printer(context, section, None) for section in context.fleet.printers)
    assert (first_view.state, first_view.look) == ("unknown", reason)
    assert second_view.state == "starting"
    assert [task.printers for task in list_tasks(context) if task.code == "connect"] == [["b"]]
