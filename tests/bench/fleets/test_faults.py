"""Figures of a lost host, in which notices about other events do not count."""

import time
from itertools import chain
from types import SimpleNamespace

import pytest

from bench.fleets import faults
from bench.fleets.faults import FIRST_HOST, PrintingFleet, measure_loss

LOSS_NOTICE = "pc-01 does not answer"


class FleetWithLateNotice:
    """Fleet whose job has just been printed, but whose notice about the job is still to be sent."""

    printing_names: tuple[str, ...] = ()

    def __init__(self):
        self.now_s, self.is_lost, self.loss_count, self.lines = 0.0, False, 0, []
        self.due_notices = {9.0: "job 2 is printed: 20 parts in 91 s"}

    def serve(self, seconds, condition=lambda: False):
        deadline_s = self.now_s + seconds
        while self.now_s < deadline_s:
            if condition():
                return True
            self.now_s += 1.0
            if self.now_s in self.due_notices:
                self.lines.append(self.due_notices[self.now_s])
        return False

    def disconnect(self, *groups):
        self.is_lost, self.loss_count = True, self.loss_count + 1
        self.due_notices[self.now_s + 10.0] = LOSS_NOTICE

    def reconnect(self, *groups):
        self.is_lost = False

    def count(self, kind, since_s):
        return self.loss_count


def test_notices_about_earlier_prints_do_not_count(monkeypatch):
    fleet = FleetWithLateNotice()
    monkeypatch.setattr(time, "monotonic", lambda: fleet.now_s)
    printers = [SimpleNamespace(state="unknown")]
    client = SimpleNamespace(
        fetch_status=lambda: SimpleNamespace(todo=[], printers=printers if fleet.is_lost else []),
        fetch_hosts=lambda: SimpleNamespace(hosts=[]),
    )
    daemon = SimpleNamespace(client=client, read_cpu_s=lambda: 0.0)
    hosts_by_group = {FIRST_HOST: ["pc-01"]}
    figures = measure_loss(PrintingFleet(daemon, fleet, fleet, hosts_by_group, fleet, fleet), [FIRST_HOST])
    assert figures["notice_texts"] == [LOSS_NOTICE] and figures["notices"] == figures["events"] == 1


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_groups_of_hosts_contain_all_hosts_in_order(count):
    hosts = [f"pc-{number}" for number in range(count)]
    groups = faults.group_hosts(hosts)
    assert [*chain.from_iterable(groups.values())] == hosts and all(groups.values())
