"""Agent with internal errors, a full disk, or heaters left on."""

import asyncio
import hashlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.agent.loop import Agent
from drivers.emulator.launch import control, read_status
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.errors import Fault, JournalError
from drivers.records import Journal, StartFile
from printers.agent_with_emulator import (
    DEADLINE_S,
    PRINTER_MODEL,
    TIME_SCALE,
    make_gcode,
    run,
    run_printer,
    wait_for_emulator,
)


class ScriptedAgent(Agent):
    """Agent in this process, with an action at each step of its loop."""

    run_step: Callable[["ScriptedAgent"], None]

    def _push_snapshot(self) -> None:
        super()._push_snapshot()
        self.run_step(self)

    def start(self, gcode_path: Path, text: str, **limits_s: float) -> m.Reply:
        gcode_path.write_text(text)
        digest = hashlib.sha256(text.encode()).hexdigest()
        request = m.StartPrint(
            id=1,
            print_id="p-1",
            gcode=str(gcode_path),
            sha256=digest,
            print_time_s=60.0,
            filament=m.Filament.PARKED,
            not_after_s=limits_s.get("not_after_s"),
            ends_by_s=limits_s.get("ends_by_s"),
        )
        return self._answer_request(request)

    @property
    def snapshot(self) -> m.Snapshot:
        return self._build_snapshot()


@pytest.fixture
def scripted_agent(tmp_path: Path) -> Iterator[ScriptedAgent]:
    handlers = [(number, signal.getsignal(number)) for number in (signal.SIGTERM, signal.SIGINT)]
    agent = ScriptedAgent(
        StartFile("um2-01", PRINTER_MODEL, f"sim://{PRINTER_MODEL}", TIME_SCALE, time.time()), tmp_path
    )
    try:
        yield agent
    finally:
        signal.set_wakeup_fd(-1)
        for number, handler in handlers:
            signal.signal(number, handler)
        if emulator_is_running(tmp_path / "emulator"):
            control(tmp_path / "emulator", "power_off")


@pytest.mark.system
def test_agent_with_an_internal_error_switches_the_heaters_off(scripted_agent: ScriptedAgent, tmp_path: Path):
    def run_step(agent: ScriptedAgent) -> None:
        snapshot = agent.snapshot
        if snapshot.link is m.LinkState.READY:
            assert agent.start(tmp_path / "a.gcode", make_gcode(50_000)).error is None
        elif snapshot.print is not None and snapshot.print.phase is m.PrintPhase.PRINTING:
            status = read_status(tmp_path / "emulator")
            assert status.nozzle_target_c > 0
            raise ZeroDivisionError("an internal error")

    scripted_agent.run_step = run_step
    with pytest.raises(ZeroDivisionError):
        scripted_agent.run()
    assert wait_for_emulator(
        tmp_path / "emulator", lambda s: (s.nozzle_target_c, s.bed_target_c) == (0.0, 0.0)
    )


@pytest.mark.system
def test_agent_without_a_writable_journal_switches_off_the_heaters_of_the_previous_agent(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(make_gcode(20_000))
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            assert rig.process is not None
            rig.process.kill()
            rig.process.wait(10.0)
            assert max(rig.read_targets()) > 0
            command = ["prlimit", "--fsize=0", sys.executable, "-m", "drivers.agent", "--folder", rig.folder]
            process_result = await asyncio.to_thread(
                subprocess.run, command, check=False, capture_output=True, text=True, timeout=DEADLINE_S
            )
            assert process_result.returncode == 1
            assert "cannot be written" in process_result.stdout and "confirmed off" in process_result.stdout
            assert rig.read_targets() == (0.0, 0.0)

    run(run_scenario())


@pytest.mark.system
def test_full_disk_neither_stops_nor_starts_a_print(
    scripted_agent: ScriptedAgent, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    is_full = False
    write_record = Journal.write
    phases: list[m.PrintPhase] = []

    def write_unless_full(journal: Journal, at_s: float, **record: object) -> None:
        if is_full:
            raise JournalError("the disk is full")
        write_record(journal, at_s, **record)

    monkeypatch.setattr(Journal, "write", write_unless_full)

    def run_step(agent: ScriptedAgent) -> None:
        nonlocal is_full
        snapshot = agent.snapshot
        if snapshot.link is m.LinkState.READY and snapshot.print is None:
            is_full = True
            assert "full" in str(agent.start(tmp_path / "a.gcode", make_gcode(300)).error)
            assert agent.snapshot.print is None
            is_full = False
            assert agent.start(tmp_path / "a.gcode", make_gcode(300)).error is None
            is_full = True
        elif snapshot.print is not None:
            phases.append(snapshot.print.phase)
            if snapshot.print.phase is m.PrintPhase.DONE:
                if is_full:
                    assert snapshot.link is m.LinkState.BUSY  # the print ends only when its record is written
                    is_full = False
                elif snapshot.link is m.LinkState.READY:
                    assert agent._answer_request(m.Shutdown(id=2)).error is None

    scripted_agent.run_step = run_step
    scripted_agent.run()
    assert m.PrintPhase.PRINTING in phases
    journal_state = Journal(tmp_path / "journal.jsonl").state
    assert journal_state.ended_print_ids == {"p-1"} and journal_state.filament is m.Filament.PARKED


@pytest.mark.system
def test_agent_lists_its_prints_including_forgotten_ones(scripted_agent: ScriptedAgent, tmp_path: Path):
    text = make_gcode(300)
    phases: list[m.PrintPhase] = []

    def list_prints(since_s: float) -> tuple[m.PrintSnapshot, ...]:
        return scripted_agent._answer_request(m.ListPrints(id=3, since_s=since_s)).prints

    def run_step(agent: ScriptedAgent) -> None:
        snapshot = agent.snapshot
        if snapshot.link is m.LinkState.READY and snapshot.print is None:
            assert list_prints(0.0) == ()
            assert agent.start(tmp_path / "a.gcode", text).error is None
        elif snapshot.print is not None and snapshot.link is m.LinkState.BUSY:
            (listed_print,) = list_prints(snapshot.now_s)
            assert listed_print.sha256 == hashlib.sha256(text.encode()).hexdigest()
            phases.append(listed_print.phase)
        elif snapshot.print is not None:
            assert agent._answer_request(m.ForgetPrint(id=2, print_id="p-1")).error is None
            (listed_print,) = list_prints(0.0)
            assert (listed_print.phase, listed_print.ended_s) == (m.PrintPhase.DONE, snapshot.print.ended_s)
            assert list_prints(snapshot.now_s + 1.0) == ()
            lines = agent._answer_request(m.ListLines(id=5)).lines
            assert ("ok", False) in [(line.text, line.sent) for line in lines]
            assert any(line.sent and "G" in line.text for line in lines)
            assert lines[-1].at_s <= snapshot.now_s + 60.0
            assert agent._answer_request(m.Shutdown(id=4)).error is None

    scripted_agent.run_step = run_step
    scripted_agent.run()
    assert m.PrintPhase.PRINTING in phases


def test_agent_refuses_to_end_while_heaters_may_be_on(scripted_agent: ScriptedAgent) -> None:
    """Keep the agent running, so that it switches the heaters off when the port returns."""
    replies = []

    def run_step(agent: ScriptedAgent) -> None:
        if agent.snapshot.link is m.LinkState.READY:
            agent._board.state.hot = True
            replies.append(agent._answer_request(m.Shutdown(id=1)).error)
            assert agent._answer_request(m.Shutdown(id=2, now=True)).error is None

    scripted_agent.run_step = run_step
    scripted_agent.run()
    assert "may still be hot" in str(replies[0])


@pytest.mark.parametrize("end_request", [m.Shutdown(id=1, now=True), signal.SIGINT])
@pytest.mark.system
def test_ending_agent_switches_off_heaters_left_on_by_an_ended_print(
    scripted_agent: ScriptedAgent, tmp_path: Path, end_request: m.Shutdown | signal.Signals
):
    was_heated = False

    def read_targets() -> set[float]:
        status = read_status(tmp_path / "emulator")
        return {status.nozzle_target_c, status.bed_target_c}

    def run_step(agent: ScriptedAgent) -> None:
        nonlocal was_heated
        board = agent._board
        if agent.snapshot.link is m.LinkState.READY and not was_heated:
            was_heated = True
            assert board._port is not None
            board._port.write_now(b"\nM104 S200\nM140 S60\n")
            assert wait_for_emulator(tmp_path / "emulator", lambda s: s.bed_target_c == 60.0)
            board.state.hot = True
            if isinstance(end_request, m.Shutdown):
                assert agent._answer_request(end_request).error is None
            else:
                signal.raise_signal(end_request)

    scripted_agent.run_step = run_step
    scripted_agent.run()
    assert wait_for_emulator(tmp_path / "emulator", lambda _: read_targets() == {0.0})


@pytest.mark.system
def test_late_start_is_refused_and_a_print_ends_by_its_time_limit_without_a_daemon(
    scripted_agent: ScriptedAgent, tmp_path: Path
):
    replies: list[m.Reply] = []
    failed_prints: list[m.PrintSnapshot] = []

    def run_step(agent: ScriptedAgent) -> None:
        snapshot, now_s = agent.snapshot, agent._clock.now()
        if snapshot.link is m.LinkState.READY and snapshot.print is None:
            replies.append(agent.start(tmp_path / "a.gcode", make_gcode(20_000), not_after_s=now_s - 1.0))
            assert agent.snapshot.print is None
            time_limits = {"not_after_s": now_s + 600.0, "ends_by_s": now_s + 10_000.0}
            assert agent.start(tmp_path / "a.gcode", make_gcode(20_000), **time_limits).error is None
        elif snapshot.print is not None and snapshot.print.phase is m.PrintPhase.PRINTING:
            if snapshot.print.ends_by_s is not None and snapshot.print.ends_by_s > now_s:
                agent._answer_request(m.EndPrintBy(id=3, print_id="another", ends_by_s=now_s))
                assert agent.snapshot.print == snapshot.print
                agent._answer_request(m.EndPrintBy(id=4, print_id="p-1", ends_by_s=now_s))
        elif snapshot.link is m.LinkState.READY and snapshot.print is not None and snapshot.print.phase.ended:
            failed_prints.append(snapshot.print)
            agent._answer_request(m.Shutdown(id=2))

    scripted_agent.run_step = run_step
    scripted_agent.run()
    assert replies[0].late and "too late" in str(replies[0].error)
    assert (failed_prints[0].phase, failed_prints[0].fault) == (m.PrintPhase.FAILED, Fault.HOURS_ENDED)
    status = read_status(tmp_path / "emulator")
    assert (status.nozzle_target_c, status.bed_target_c) == (0.0, 0.0)
