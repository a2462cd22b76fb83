"""Update of the agents of all hosts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.host import AgentPhase, AgentState, HostState, Update, UpdatePhase
from farm.agents.host_record import HostChange, HostRecord
from farm.agents.hosts import compute_report_interval_s
from farm.agents.rollout import RolloutStep, plan_rollout

CURRENT_UPDATE, OUTDATED_UPDATE, RUNNING_UPDATE, FAILED_UPDATE = (
    Update(phase=phase, reason="why") for phase in UpdatePhase
)
UPDATES = st.dictionaries(
    st.sampled_from("abcde"),
    st.sampled_from([None, CURRENT_UPDATE, OUTDATED_UPDATE, RUNNING_UPDATE, FAILED_UPDATE]),
)


def test_one_host_is_updated_first_and_the_others_follow_when_it_is_done():
    assert plan_rollout({"a": CURRENT_UPDATE, "b": OUTDATED_UPDATE, "c": OUTDATED_UPDATE}, ()) == RolloutStep(
        hosts_to_begin=("b",)
    )
    assert (
        plan_rollout({"a": CURRENT_UPDATE, "b": RUNNING_UPDATE, "c": OUTDATED_UPDATE}, ("b",))
        == RolloutStep()
    )
    updates = plan_rollout({"a": OUTDATED_UPDATE, "b": CURRENT_UPDATE, "c": OUTDATED_UPDATE}, ("b",))
    assert updates == RolloutStep(hosts_to_begin=("a", "c"))
    assert plan_rollout({"a": CURRENT_UPDATE, "b": CURRENT_UPDATE}, ("b",)).is_finished


def test_first_fault_ends_the_update_on_all_hosts():
    step = plan_rollout(
        {"a": CURRENT_UPDATE, "b": FAILED_UPDATE, "c": RUNNING_UPDATE, "d": OUTDATED_UPDATE}, ("a", "b", "c")
    )
    assert step == RolloutStep(hosts_to_halt=("c",), is_finished=True, fault="b: why")


def test_host_that_failed_before_is_tried_again_by_a_new_update():
    assert plan_rollout({"a": FAILED_UPDATE}, ()) == RolloutStep(hosts_to_begin=("a",))


def test_rollout_waits_for_a_host_that_is_not_connected():
    assert plan_rollout({"a": None, "b": CURRENT_UPDATE}, ("b",)) == RolloutStep()


def test_update_begins_again_on_a_host_whose_service_was_restarted():
    assert plan_rollout({"a": OUTDATED_UPDATE, "b": OUTDATED_UPDATE}, ("a",)) == RolloutStep(
        hosts_to_begin=("a",)
    )
    step = plan_rollout({"a": CURRENT_UPDATE, "b": OUTDATED_UPDATE, "c": RUNNING_UPDATE}, ("a", "b", "c"))
    assert step == RolloutStep(hosts_to_begin=("b",))


def test_state_from_before_an_update_is_not_taken_as_its_result():
    record = HostRecord("pc-b", ("a",), 100.0)
    failed_host = HostState(pid=1, update=FAILED_UPDATE)
    record.on_state(101.0, failed_host)
    record.on_update_begun()
    record.on_state(102.0, failed_host)  # in transit when the update began
    assert record.update is not None and record.update.phase is UpdatePhase.RUNNING
    record.on_state(103.0, HostState(pid=1, update=RUNNING_UPDATE))
    record.on_state(104.0, failed_host)
    assert record.update == FAILED_UPDATE


def test_update_begins_again_when_its_request_was_lost_with_the_connection():
    record = HostRecord("pc-b", ("a",), 100.0)
    record.on_state(101.0, HostState(pid=1, update=OUTDATED_UPDATE))
    record.on_update_begun()
    record.on_lost(102.0, "no route")
    record.on_state(103.0, HostState(pid=1, update=OUTDATED_UPDATE))
    assert record.update == OUTDATED_UPDATE


@given(UPDATES, st.sets(st.sampled_from("abcde")))
def test_nothing_begins_before_the_first_host_is_done_nor_after_a_fault(updates, names):
    started_hosts = tuple(sorted(names & updates.keys()))
    step = plan_rollout(updates, started_hosts)
    assert all(updates[host] is not None for host in step.hosts_to_begin)
    assert all(updates[host] is OUTDATED_UPDATE for host in set(step.hosts_to_begin) & set(started_hosts))
    if started_hosts and updates[started_hosts[0]] is not CURRENT_UPDATE:
        assert set(step.hosts_to_begin) <= set(started_hosts)
    if any(updates[host] is FAILED_UPDATE for host in started_hosts):
        assert step.is_finished and step.fault and not step.hosts_to_begin
    if not started_hosts:
        assert len(step.hosts_to_begin) <= 1


def test_new_daemon_waits_longer_before_it_reports_a_host_as_lost():
    record = HostRecord("pc-b", ("a",), 100.0)
    record.on_lost(102.0, "no route")
    assert record.find_change(144.0, 1.0) is None
    assert record.find_change(145.0, 1.0) is HostChange.LOST


def test_loss_is_reported_once_after_ten_seconds_and_the_return_once():
    record = HostRecord("pc-b", ("a",), 100.0)
    record.on_state(101.0, HostState(pid=1))
    record.on_lost(200.0, "no route")
    record.on_lost(205.0, "no route")
    assert record.find_change(209.0, 1.0) is None
    assert record.find_change(210.0, 1.0) is HostChange.LOST
    record.is_loss_reported = True
    assert record.find_change(300.0, 1.0) is None
    assert record.describe_wait() == "a connection: no route"
    record.on_state(301.0, HostState(pid=2))
    assert record.find_change(301.0, 1.0) is HostChange.RECONNECTED
    assert record.describe_wait() is None


@pytest.mark.parametrize(
    ("reason", "suffix"), [("its agent ended with 1", " (its agent ended with 1)"), (None, "")]
)
def test_wait_for_agents_names_them_with_the_reason_if_it_is_known(reason: str | None, suffix: str) -> None:
    record = HostRecord("pc-b", ("a", "b"), 100.0)
    agents = [AgentState(printer=name, phase=AgentPhase.WAITING, reason=reason) for name in ("a", "b")]
    record.on_state(101.0, HostState(pid=1, agents=agents))
    assert record.describe_wait() == f"agents that have to start again: a b{suffix}"


def test_report_interval_limits_the_reports_of_the_fleet_to_200_a_second():
    assert [compute_report_interval_s(printers) for printers in (1, 200, 400, 1000, 5000)] == [1, 1, 2, 5, 5]
