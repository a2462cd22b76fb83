"""Alarms for a heater that cannot be switched off: the mains are cut once, in the background."""

import json
import os
import select
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.agent.board import Board
from drivers.agent.recorder import Recorder
from drivers.clock import Clock
from drivers.errors import Fault, JournalError
from drivers.link.replies import LinkFault, Report
from drivers.messages import Filament, PrintPhase, PrintSnapshot
from drivers.records import JOURNAL, Alarm, Journal, StartFile, read_journal
from drivers.safety import NO_COMMAND_OUTCOME
from printers.print_rig import PLUS_PROFILE, Rig, make_gcode

DEADLINE_S = 120.0
CUT_OUTCOME = "power_off_cmd cut its mains"


class AgentRig:
    """Recorder and board of one agent, without a loop, a port or a print."""

    def __init__(self, folder: Path, command: str | None) -> None:
        self.folder = folder
        self.journal = Journal(folder / JOURNAL)
        start_file = StartFile("um2-01", PLUS_PROFILE.model, "sim://ultimaker2_plus", power_off_cmd=command)
        self.board = Board(
            "sim://ultimaker2_plus", PLUS_PROFILE, folder, Clock(), lambda: None, lambda _: None
        )
        self.recorder = Recorder(start_file, self.board, self.journal, Clock())

    def report(self, nozzle_c: float, count: int = 3) -> None:
        """Pass reports of an idle board to the agent."""
        for _ in range(count):
            self.board._on_idle_report(Report(nozzle_c, 0.0, 21.0, 0.0), 0.0)
            self.recorder.record_changes()

    def wait_until(self, condition: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline_s
            select.select([], [], [], 0.01)
            self.recorder.record_changes()

    def wait_for_outcome(self) -> Alarm:
        """Wait for the outcome of the command, and return the alarm."""
        self.wait_until(lambda: self.alarm is None or self.alarm.outcome is not None)
        assert self.alarm is not None
        return self.alarm

    @property
    def alarm(self) -> Alarm | None:
        return self.recorder.alarms.alarm

    @property
    def attention_reason(self) -> str:
        return str(self.board.state.attention_reason)


@pytest.fixture
def run_log(tmp_path: Path) -> Path:
    return tmp_path / "run_log"


def write_relay_script(run_log: Path, command: str = "") -> str:
    script = run_log.with_name("relay.sh")
    script.write_text(f'#!/bin/sh\necho "$1" >> {run_log}\n{command}\n')
    script.chmod(0o700)
    return f"{script} {{printer}}"


def count_runs(run_log: Path) -> int:
    return run_log.read_text().count("um2-01\n") if run_log.exists() else 0


def test_finding_on_an_idle_printer_cuts_the_mains_once(tmp_path: Path, run_log: Path):
    agent = AgentRig(tmp_path, write_relay_script(run_log))
    agent.report(21.0)
    agent.report(90.0, 50)
    alarm = agent.wait_for_outcome()
    agent.report(120.0, 50)
    assert alarm.outcome == CUT_OUTCOME and count_runs(run_log) == 1
    assert agent.attention_reason.count("is getting hotter") == agent.attention_reason.count(CUT_OUTCOME) == 1


def test_printer_with_an_attention_reason_has_its_mains_cut(tmp_path: Path, run_log: Path):
    agent = AgentRig(tmp_path, write_relay_script(run_log))
    agent.board.state.attention_reason = "its print failed"
    agent.report(21.0)
    agent.report(90.0)
    agent.wait_for_outcome()
    assert count_runs(run_log) == 1 and agent.attention_reason.startswith(
        "its print failed; the nozzle is off"
    )


def test_maxtemp_on_an_idle_board_cuts_the_mains(tmp_path: Path, run_log: Path):
    """Cut the mains immediately, because no report can show a rise without a link."""
    agent = AgentRig(tmp_path, write_relay_script(run_log))
    agent.report(21.0)
    agent.board._on_idle_fault(LinkFault(Fault.MAXTEMP, "MAXTEMP triggered"), 0.0)
    agent.report(21.0)
    agent.wait_for_outcome()
    assert count_runs(run_log) == 1
    assert agent.attention_reason == (
        "the board reports MAXTEMP triggered, and both targets are 0, so a heater is stuck on or a sensor is "
        f"broken: switch it off; {CUT_OUTCOME}"
    )


def test_person_is_notified_once_without_a_command(tmp_path: Path):
    agent = AgentRig(tmp_path, None)
    agent.report(21.0)
    agent.report(90.0, 50)
    assert agent.attention_reason.count(NO_COMMAND_OUTCOME) == 1 and len(agent.attention_reason) < 200


def test_finding_counts_again_after_the_printer_was_cold_absent_or_checked(tmp_path: Path, run_log: Path):
    agent = AgentRig(tmp_path, write_relay_script(run_log))

    def check_run_after_hot_reports(expected_count: int) -> None:
        agent.report(21.0)
        agent.report(90.0, 5)
        agent.wait_for_outcome()
        assert count_runs(run_log) == expected_count

    check_run_after_hot_reports(1)
    check_run_after_hot_reports(2)  # the printer was cold in between
    agent.board.absent_reason, agent.board.alarm_is_over = None, True  # the printer is connected again
    agent.board.idle_watch.reset()
    agent.report(60.0)
    agent.report(90.0)
    agent.wait_for_outcome()
    assert count_runs(run_log) == 3
    agent.recorder.alarms.clear()
    assert agent.alarm is None
    check_run_after_hot_reports(4)


def test_request_is_in_the_journal_before_the_command_runs(tmp_path: Path, run_log: Path):
    agent = AgentRig(
        tmp_path, write_relay_script(run_log, f"cp {tmp_path / JOURNAL} {tmp_path}/journal_copy")
    )
    agent.report(21.0)
    agent.report(90.0)
    agent.wait_for_outcome()
    last_record = json.loads((tmp_path / "journal_copy").read_text().splitlines()[-1])
    assert last_record["alarm"]["asked"] and last_record["alarm"]["said"] is None


def test_next_agent_completes_a_requested_power_off(tmp_path: Path, run_log: Path):
    alarm = Alarm(text="the nozzle is off, but is getting hotter", at_s=5.0, power_off_requested=True)
    Journal(tmp_path / JOURNAL).write(5.0, alarm=alarm.dump_record())
    assert read_journal(tmp_path / JOURNAL)[0].may_be_hot
    for _ in range(2):  # the second agent does not run the command again
        agent = AgentRig(tmp_path, write_relay_script(run_log))
        agent.recorder.record_changes()
        assert agent.wait_for_outcome().outcome == CUT_OUTCOME
        agent.recorder.record_changes()
        assert count_runs(run_log) == 1
    assert agent.attention_reason == f"{alarm.text}; {CUT_OUTCOME}"


def test_next_agent_cuts_the_mains_for_a_heater_not_seen_to_cool(tmp_path: Path, run_log: Path):
    alarm = Alarm(text="the nozzle went up to 250 C, above 210", at_s=5.0)
    Journal(tmp_path / JOURNAL).write(5.0, alarm=alarm.dump_record())
    agent = AgentRig(tmp_path, write_relay_script(run_log))
    agent.recorder.record_changes()
    agent.wait_for_outcome()
    assert count_runs(run_log) == 1 and alarm.text in agent.attention_reason


def test_full_disk_does_not_prevent_the_power_off(tmp_path: Path, run_log: Path):
    agent = AgentRig(tmp_path, write_relay_script(run_log))

    def fail_on_full_disk(at_s: float, **record: object) -> None:
        raise JournalError("full")

    agent.journal.write = fail_on_full_disk  # type: ignore[method-assign]
    agent.report(21.0)
    agent.report(90.0, 20)
    assert agent.wait_for_outcome().outcome == CUT_OUTCOME and count_runs(run_log) == 1


def test_hanging_command_does_not_block_the_agent(tmp_path: Path, run_log: Path):
    """Check that reports are handled while the command runs, and its outcome is recorded when it ends."""
    os.mkfifo(tmp_path / "gate")
    agent = AgentRig(tmp_path, write_relay_script(run_log, f"read go < {tmp_path}/gate"))
    agent.report(21.0)
    agent.report(90.0)
    agent.wait_until(lambda: count_runs(run_log) == 1)
    agent.report(99.0, 100)
    assert agent.alarm is not None and agent.alarm.is_pending
    (tmp_path / "gate").write_text("go\n")
    assert agent.wait_for_outcome().outcome == CUT_OUTCOME and count_runs(run_log) == 1


# --- during a print ---


def start_print(folder: Path, command: str | None) -> tuple[AgentRig, Rig]:
    agent, rig = AgentRig(folder, command), Rig(text=make_gcode(4000)).run_until_printing(300)
    print_snapshot = PrintSnapshot(print_id="p-1", phase=PrintPhase.PRINTING, extruded=True)
    agent.journal.write(0.0, print=print_snapshot.model_dump(mode="json"), filament=Filament.AT_NOZZLE.value)
    agent.board.session = rig.session
    return agent, rig


def step_until(agent: AgentRig, rig: Rig, condition: Callable[[], bool]) -> None:
    """Run session and recorder together until a condition holds; after the session, wait for the command."""
    while not condition():
        if rig.session.context.has_ended:
            agent.wait_until(condition)
        else:
            rig.step()
            agent.recorder.record_changes()


@pytest.mark.parametrize("has_command", [True, False])
@pytest.mark.parametrize("heater", ["nozzle", "bed"])
def test_mains_are_cut_once_at_the_end_of_a_print_with_a_short_reason(
    tmp_path: Path, run_log: Path, heater: str, has_command: bool
):
    agent, rig = start_print(tmp_path, write_relay_script(run_log) if has_command else None)
    rig.firmware.trigger_fault(f"{heater}_burns_after", rig.now_s)
    step_until(agent, rig, lambda: agent.alarm is not None)
    assert rig.session.context.phase is PrintPhase.ENDING  # people are notified before the print has ended
    alarm = read_journal(tmp_path / JOURNAL)[0].alarm
    assert alarm is not None and alarm.is_suspicion and f"the {heater} went up to" in alarm.text
    step_until(agent, rig, lambda: agent.board.session is None)
    ended_print = agent.journal.state.print
    assert ended_print is not None and ended_print.phase is PrintPhase.FAILED
    outcome = CUT_OUTCOME if has_command else NO_COMMAND_OUTCOME
    assert str(ended_print.reason).count(outcome) == 1 and len(str(ended_print.reason)) < 250
    assert count_runs(run_log) == has_command
    assert agent.attention_reason == ended_print.reason
    agent.report(300.0)
    agent.report(350.0, 20)  # a heater that stays hot is not a new finding
    assert count_runs(run_log) == has_command and agent.attention_reason == ended_print.reason


def test_end_of_a_print_waits_for_the_outcome_of_the_command(tmp_path: Path, run_log: Path):
    os.mkfifo(tmp_path / "gate")
    agent, rig = start_print(
        tmp_path, write_relay_script(run_log, f"read go < {tmp_path}/gate; echo no >&2; exit 1")
    )
    rig.firmware.trigger_fault("nozzle_burns_after", rig.now_s)
    step_until(agent, rig, lambda: rig.session.context.has_ended)
    agent.recorder.record_changes()
    assert agent.board.session is not None and agent.journal.state.print is not None
    print_snapshot = agent.recorder.describe_print(agent.journal.state.print, rig.session.context)
    assert print_snapshot.phase is PrintPhase.ENDING and print_snapshot.ended_s is None
    (tmp_path / "gate").write_text("go\n")
    step_until(agent, rig, lambda: agent.board.session is None)
    assert "power_off_cmd failed (no): switch it off by hand" in agent.attention_reason


def test_cooling_heater_ends_the_alarm(tmp_path: Path, run_log: Path):
    agent, rig = start_print(tmp_path, write_relay_script(run_log))
    rig.firmware.trigger_fault("nozzle_burns_after", rig.now_s)
    step_until(agent, rig, lambda: agent.alarm is not None)
    rig.firmware.board.nozzle.compute_temperature_c(rig.now_s)
    rig.firmware.board.nozzle.is_mosfet_shorted = False
    step_until(agent, rig, lambda: agent.board.session is None)
    assert agent.alarm is None and read_journal(tmp_path / JOURNAL)[0].alarm is None
    assert count_runs(run_log) == 0 and "went up to" in agent.attention_reason


def test_cancelled_print_with_a_stuck_heater_needs_attention(tmp_path: Path, run_log: Path):
    agent, rig = start_print(tmp_path, write_relay_script(run_log))
    rig.firmware.trigger_fault("nozzle_burns_after", rig.now_s)
    rig.session.cancel("no more", rig.now_s)
    step_until(agent, rig, lambda: agent.board.session is None)
    assert count_runs(run_log) == 1
    assert agent.attention_reason.startswith("no more; the nozzle is off, but is getting hotter")
