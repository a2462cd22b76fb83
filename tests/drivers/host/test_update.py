"""Update of the agents of one host, with simulated agents."""

import asyncio
from collections.abc import Callable

import pytest

from drivers import messages as m
from drivers.errors import AgentError
from drivers.host import UpdatePhase, update
from drivers.host.update import AgentsUpdate, HealthObservation, check_health
from drivers.remote import Installation

OLD_INSTALLATION, NEW_INSTALLATION = Installation("/old/python", "/old"), Installation("/new/python", "/new")


class FakeSupervisor:
    """Simulated agent that restarts with the new installation, or with the one that it keeps."""

    def __init__(self, printer: str, is_printing: bool = False, new_link: m.LinkState | None = None) -> None:
        self.printer, self.is_wanted, self.kept_installation = printer, True, None
        self.new_link = new_link or m.LinkState.READY
        self.snapshot = self.make_snapshot(
            m.LinkState.BUSY if is_printing else m.LinkState.READY, is_printing
        )
        self.installation = OLD_INSTALLATION
        self.is_running = True
        self.start_count = self.last_ended_start = 0
        self.ignores_end = False  # True if the new agent does not end

    def make_snapshot(self, link: m.LinkState, is_printing: bool = False) -> m.Snapshot:
        report = m.PrintSnapshot(print_id="p", phase=m.PrintPhase.PRINTING) if is_printing else None
        return m.Snapshot(
            printer=self.printer, agent_pid=1, link=link, print=report, reason="its port is gone"
        )

    def find_installation(self) -> Installation:
        return self.installation

    async def end(self) -> None:
        if self.snapshot is not None and self.snapshot.print is not None:
            raise AgentError("it is printing")
        if self.ignores_end and self.installation == NEW_INSTALLATION:
            raise AgentError("it does not answer")
        self.installation = self.kept_installation or NEW_INSTALLATION
        asyncio.get_running_loop().call_later(0.0, self.start)

    def start(self) -> None:
        self.snapshot = self.make_snapshot(
            self.new_link if self.installation == NEW_INSTALLATION else m.LinkState.READY
        )

    def kill(self) -> None:
        self.installation = self.kept_installation or NEW_INSTALLATION

    def reset_backoff(self) -> None:
        """Do nothing, because a simulated agent starts immediately."""


def run_update(supervisors: list[FakeSupervisor], condition: Callable[[AgentsUpdate], bool]) -> AgentsUpdate:
    """Begin an update, and step until a condition holds."""

    async def run() -> AgentsUpdate:
        agents_update, tasks = AgentsUpdate(NEW_INSTALLATION, lambda: None), set()
        assert agents_update.describe(supervisors).phase is UpdatePhase.OUTDATED
        agents_update.begin()
        async with asyncio.timeout(20):
            while not condition(agents_update):
                agents_update.step(supervisors, lambda work: tasks.add(asyncio.create_task(work)))
                await asyncio.sleep(0)
            await asyncio.gather(*tasks)
        return agents_update

    return asyncio.run(run())


@pytest.fixture(autouse=True)
def _short_poll_interval(monkeypatch):
    monkeypatch.setattr(update, "_POLL_INTERVAL_S", 0.0)


def test_idle_agents_are_replaced_one_by_one():
    supervisors = [FakeSupervisor("a"), FakeSupervisor("b")]
    run_update(
        supervisors, lambda agents_update: agents_update.describe(supervisors).phase is UpdatePhase.CURRENT
    )
    assert [supervisor.installation for supervisor in supervisors] == [NEW_INSTALLATION, NEW_INSTALLATION]


def test_printing_agent_is_not_replaced_before_its_print_has_ended():
    supervisors = [FakeSupervisor("a", is_printing=True), FakeSupervisor("b")]
    agents_update = run_update(supervisors, lambda _: supervisors[1].installation == NEW_INSTALLATION)
    assert supervisors[0].installation == OLD_INSTALLATION
    assert agents_update.describe(supervisors).phase is UpdatePhase.RUNNING
    assert "a" in str(agents_update.describe(supervisors).reason)


def test_first_fault_restores_the_old_version_and_ends_the_update(tmp_path, monkeypatch):
    monkeypatch.setattr(Installation, "exists", True)
    supervisors = [FakeSupervisor("a", new_link=m.LinkState.FAULT), FakeSupervisor("b")]
    agents_update = run_update(
        supervisors, lambda agents_update: agents_update.describe(supervisors).phase is UpdatePhase.FAILED
    )
    assert [supervisor.installation for supervisor in supervisors] == [OLD_INSTALLATION, OLD_INSTALLATION]
    assert supervisors[0].kept_installation == OLD_INSTALLATION
    reason = str(agents_update.describe(supervisors).reason)
    assert "a: its new agent reports: its port is gone; its old version is started again" in reason


def test_new_agent_that_does_not_end_is_killed_and_replaced_by_the_old_one(monkeypatch):
    monkeypatch.setattr(Installation, "exists", True)
    supervisor = FakeSupervisor("a", new_link=m.LinkState.FAULT)
    supervisor.ignores_end = True
    run_update(
        [supervisor], lambda agents_update: agents_update.describe([supervisor]).phase is UpdatePhase.FAILED
    )
    assert supervisor.installation == OLD_INSTALLATION


def test_new_agent_is_judged_by_its_link_and_the_time_since_its_start():
    ready_report, fault_report, absent_report = (
        FakeSupervisor("a").make_snapshot(link)
        for link in (m.LinkState.READY, m.LinkState.FAULT, m.LinkState.ABSENT)
    )
    report = FakeSupervisor("a").make_snapshot(m.LinkState.CONNECTING)
    old_link = m.LinkState.READY
    assert check_health(HealthObservation(old_link, ready_report, False, 5.0)) is True
    assert check_health(HealthObservation(old_link, report, False, 5.0)) is False
    assert (
        check_health(HealthObservation(old_link, None, False, 5.0)) is False
    )  # a busy computer starts an agent late
    assert check_health(HealthObservation(old_link, None, True, 0.1)) == "its new agent has ended"
    assert "its port is gone" in str(check_health(HealthObservation(old_link, fault_report, False, 5.0)))
    # The printer was absent before the update too, so the update is not the cause.
    assert check_health(HealthObservation(m.LinkState.ABSENT, absent_report, False, 5.0)) is True
    assert "was not ready within 90 s" in str(check_health(HealthObservation(old_link, report, False, 100.0)))
