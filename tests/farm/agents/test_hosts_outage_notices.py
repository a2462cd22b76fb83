"""Notices of lost hosts: one for each outage, in whatever order agents and hosts are lost and come back."""

import tempfile
from collections import Counter
from pathlib import Path

from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)

from books.recording_controller import PLUS_MODEL, RecordedEffects
from drivers.host import HostState
from farm.agents.hosts import Hosts
from farm.config import Fleet
from farm.control.controller import Controller
from farm.model import AgentSnapshot, FilamentState, Link
from farm.paths import StateFolder
from farm.planning.printer_settings import list_bed_boxes
from farm.state import events as ev
from farm.state.storage import Store
from farm.views import list_due_notices
from hosts.manual_clock import ManualClock

HOSTS = ("pc-a", "pc-b", "pc-c")
PRINTERS = {f"{host}-{number}": host for host in HOSTS for number in (1, 2)}
ALL_DELAYS_S = 100.0  # longer than all delays of losses and of notices together


class LostHosts(RuleBasedStateMachine):
    """Hosts and controller of a daemon; every lasting loss of a host is in exactly one notice."""

    @initialize()
    def make_farm(self):
        self.folder = tempfile.TemporaryDirectory()
        self.clock = ManualClock(1e6)
        fields = {"model": PLUS_MODEL, "port": f"sim://{PLUS_MODEL}", "host_command": "farm host"}
        rows = [{"name": name, "host": host, **fields} for name, host in PRINTERS.items()]
        self.fleet = Fleet.model_validate({"printers": rows})
        self.sent_keys, self.loss_counts = set(), Counter()
        self.notice_counts = Counter()  # keys: host and number of its loss
        self.open_daemon()
        for host in HOSTS:
            self.reconnect_host(host)

    def open_daemon(self):
        self.store = Store(Path(self.folder.name) / "farm.db")
        self.controller = Controller(self.fleet, self.store, self.clock, list_bed_boxes)
        self.controller.start(RecordedEffects())
        self.hosts = Hosts(self.fleet, StateFolder(Path(self.folder.name)), self.clock, self)
        self.records = {record.host: record for record in self.hosts.records}
        for host, record in self.records.items():
            record.is_loss_reported = host in self.controller.books.lost_hosts

    def handle(self, *events):
        """Count losses, as the listener of the hosts, before the controller records them."""
        self.loss_counts.update(event.host for event in events if isinstance(event, ev.HostLost))
        self.controller.handle(*events)

    def warn(self, topic, text):
        raise AssertionError(text)

    @rule()
    def restart_daemon(self):
        self.store.close()
        self.open_daemon()

    @rule(host=st.sampled_from(HOSTS), reason=st.sampled_from(["time-out", "no route"]))
    def lose_host(self, host, reason):
        self.records[host].on_lost(self.clock.now(), reason)

    @rule(host=st.sampled_from(HOSTS))
    def reconnect_host(self, host):
        self.records[host].on_state(self.clock.now(), HostState(pid=1))

    @rule(name=st.sampled_from(sorted(PRINTERS)))
    def lose_agent(self, name):
        """Lose the stream of an agent before its host is lost, or together with it."""
        is_host_lost = self.records[PRINTERS[name]].disconnected_s is not None
        loss = "no connection to its host" if is_host_lost else None
        self.report_snapshot(name, link=Link.STARTING, reason=loss, host_lost=is_host_lost)

    @rule(name=st.sampled_from(sorted(PRINTERS)), link=st.sampled_from([Link.CONNECTING, Link.READY]))
    def reconnect_agent(self, name, link):
        self.report_snapshot(name, link=link, agent_pid=9, filament=FilamentState.PARKED, bed_clear=True)

    def report_snapshot(self, name, **fields):
        self.controller.on_snapshot(AgentSnapshot(printer=name, **fields))

    @rule(duration_s=st.sampled_from([0.5, 5.0, 10.0, 45.0]), is_notified_first=st.booleans())
    def wait(self, duration_s, is_notified_first):
        self.clock.now_s += duration_s
        for work in (self.notify, self.hosts.watch) if is_notified_first else (self.hosts.watch, self.notify):
            work()

    def notify(self):
        now_s = self.clock.now()
        notices = list_due_notices(self.controller.books, now_s, 0.0, self.sent_keys)
        host_losses = [printer.host_loss for printer in self.controller.books.printers.values()]
        for notice in notices:
            hosts = {loss.host for loss in host_losses if loss is not None and loss.at_s == notice.at_s}
            assert notice.key.startswith("hosts ") and hosts, notice
            self.notice_counts.update((host, self.loss_counts[host]) for host in hosts)
        self.sent_keys |= {notice.key for notice in notices}
        assert set(self.notice_counts.values()) <= {1}, self.notice_counts

    @precondition(lambda self: self.controller.books.lost_hosts)
    @rule()
    def wait_for_notices(self):
        self.clock.now_s += ALL_DELAYS_S
        self.notify()
        for host in self.controller.books.lost_hosts:
            assert self.notice_counts[host, self.loss_counts[host]] == 1, host

    def teardown(self):
        if hasattr(self, "store"):
            self.store.close()
            self.folder.cleanup()


def test_each_lasting_loss_of_a_host_is_in_one_notice():
    run_state_machine_as_test(LostHosts)


def test_clock_step_neither_causes_nor_hides_a_loss(tmp_path):
    machine = LostHosts()
    machine.make_farm()
    try:
        for step_s in (-3600.0, 3600.0):
            machine.reconnect_host("pc-a")
            machine.hosts.watch()
            loss_count = machine.loss_counts["pc-a"]
            machine.lose_host("pc-a", "time-out")
            machine.wait(5.0, is_notified_first=True)
            machine.clock.now_s += step_s
            machine.hosts.on_clock_set(step_s)
            machine.hosts.watch()
            assert machine.loss_counts["pc-a"] == loss_count
            machine.wait(10.0, is_notified_first=True)
            assert machine.loss_counts["pc-a"] == loss_count + 1
    finally:
        machine.teardown()
