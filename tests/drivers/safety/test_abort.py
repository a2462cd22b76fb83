"""Abort sequence, sent to the emulated firmware."""

from __future__ import annotations

import os
import pty
import tty
from pathlib import Path

import pytest

from drivers.agent.board import Board
from drivers.clock import Clock
from drivers.emulator.faults import Faults
from drivers.emulator.firmware.listener import RING_BYTES
from drivers.firmware import MARLIN2, ULTIMAKER2
from drivers.link import BoardConnected, Event, Link
from drivers.ports import Port, SerialPort
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from drivers.safety import StopTarget, send_abort_until_accepted, stop_printer
from printers.agent_with_emulator import read_buffered_bytes
from printers.firmware_host import Host, add_number

MOVE_S = 2.0
MAX_LINE_BYTES = 95  # with its newline
BLOCKING_MOVE_COUNT = 18  # the moves that fill the planner, and one that waits


def make_busy_host(moves: int = BLOCKING_MOVE_COUNT, model: str = "ultimaker2_plus") -> Host:
    """Make a hot board with its fan on and a planner full of moves of 2 s."""
    host = Host(model, Faults(no_reset=True))
    host.send("G28")
    host.send("M140 S60")
    host.send("M106 S255")
    host.heat_nozzle()
    host.send("G1 F12000 X50 Y50")
    host.send("M400")
    for i in range(moves):
        host.send_numbered(f"G1 F1200 X{90 if i % 2 == 0 else 50}")
    return host


def exchange_bytes(host: Host, link: Link, seconds: float) -> list[Event]:
    """Pass bytes between link and board for some seconds; return the events of the link."""
    events: list[Event] = []
    end_s = host.now_s + seconds
    while True:
        sent_bytes = link.take()
        if not sent_bytes:
            host.now_s = min(max(host.now_s, host.firmware.compute_deadline_s()), link.deadline_s, end_s)
        answer = host.firmware.feed(sent_bytes, host.now_s)
        events += link.receive(answer, host.now_s)
        events += link.tick(host.now_s)
        if host.now_s >= end_s:
            return events
        if not (sent_bytes or answer):
            host.now_s += 1e-4


def has_ended(host: Host) -> bool:
    board, machine = host.board, host.firmware.machine
    return (
        board.nozzle.target_c == board.bed.target_c == 0.0
        and not machine.waiting_moves
        and not machine.planner
    )


def test_abort_switches_heaters_off_and_ends_queued_moves_within_one_move():
    host = make_busy_host()
    host.firmware.feed(ULTIMAKER2.unnumbered_abort, host.now_s)
    assert not has_ended(host)
    host.wait(1.1 * MOVE_S)
    assert has_ended(host)


@pytest.mark.parametrize("truncated_line", ["G1 X7", "N19 G1 X70 Y5", "N1"])
def test_truncated_line_before_the_abort_delays_it_by_one_move_at_most(truncated_line: str):
    host = make_busy_host()
    host.firmware.feed(truncated_line.encode(), host.now_s)
    host.firmware.feed(ULTIMAKER2.unnumbered_abort, host.now_s)
    link = Link(ULTIMAKER2)
    link.on_opened(host.now_s, ULTIMAKER2.unnumbered_abort)
    events = exchange_bytes(host, link, 2.1 * MOVE_S)
    assert has_ended(host)
    [connection] = [event for event in events if isinstance(event, BoardConnected)]
    assert not connection.has_restarted


def test_longest_line_the_abort_and_a_poll_fit_into_the_receive_buffer():
    assert MAX_LINE_BYTES + len(ULTIMAKER2.unnumbered_abort) + len(b"M105\n") <= RING_BYTES
    host = make_busy_host()
    line = add_number(host.last_number + 1, "G1 X90 " + " " * 80)[: MAX_LINE_BYTES - 1]
    host.send_burst(line.ljust(MAX_LINE_BYTES - 1))
    host.firmware.feed(ULTIMAKER2.unnumbered_abort, host.now_s)
    link = Link(ULTIMAKER2)
    link.on_opened(host.now_s, ULTIMAKER2.unnumbered_abort)
    exchange_bytes(host, link, 3.1 * MOVE_S)
    assert has_ended(host) and link.is_drained


def test_on_marlin_2_moves_end_at_once_and_heaters_are_off_a_second_later():
    host = make_busy_host(model="creality_ender3")
    host.firmware.feed(MARLIN2.unnumbered_abort, host.now_s)
    assert not host.firmware.machine.planner
    host.wait(1.1)
    assert has_ended(host)
    link = Link(MARLIN2)
    link.on_opened(host.now_s, MARLIN2.unnumbered_abort)
    [connection] = [event for event in exchange_bytes(host, link, 5.0) if isinstance(event, BoardConnected)]
    assert not connection.has_restarted
    link.send(host.now_s, *MARLIN2.abort_commands, MARLIN2.wait_command)
    exchange_bytes(host, link, 5.0)
    assert has_ended(host) and link.is_drained


def test_restart_is_detected_if_the_board_loses_the_abort():
    host = make_busy_host()
    host.firmware.feed(ULTIMAKER2.unnumbered_abort, host.now_s)
    host.firmware.reset(host.now_s)
    link = Link(ULTIMAKER2)
    link.on_opened(host.now_s, ULTIMAKER2.unnumbered_abort)
    events = exchange_bytes(host, link, 5.0)
    assert [event.has_restarted for event in events if isinstance(event, BoardConnected)] == [True]
    assert has_ended(host) and link.is_drained


@pytest.fixture
def silent_board():
    """Open a pseudo-terminal; return the port and its silent other end."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave), master
    os.close(slave)
    os.close(master)


def test_emergency_stop_sends_the_abort_before_it_waits(tmp_path: Path, silent_board):
    url, master = silent_board
    result = stop_printer(StopTarget("a", url, tmp_path / "a", ULTIMAKER2), report_timeout_s=0.0)
    assert read_buffered_bytes(master) == ULTIMAKER2.unnumbered_abort
    assert not (result.is_confirmed_off or result.is_still) and "may still be moving" in result.text


def test_unresponsive_board_is_halted_by_its_firmware(tmp_path: Path, silent_board):
    url, master = silent_board
    result = stop_printer(StopTarget("a", url, tmp_path / "a", MARLIN2), report_timeout_s=0.0)
    assert read_buffered_bytes(master) == b"\nM410\nM104 S0\nM140 S0\nM107\n" + b"\nM112\n"
    assert not result.is_confirmed_off and "switch it off" in result.text


def test_agent_that_finds_an_open_print_sends_the_abort_on_opening_the_port(tmp_path: Path, silent_board):
    url, master = silent_board
    board = Board(url, ULTIMAKER2_PLUS, tmp_path, Clock(1.0, 0.0), lambda: None, lambda _: None)
    board.state.hot = True
    board.open()
    try:
        assert read_buffered_bytes(master) == ULTIMAKER2.unnumbered_abort
    finally:
        board.close()


def test_agent_that_ends_repeats_the_abort_after_a_refusal(silent_board):
    url, master = silent_board
    port: Port = SerialPort(Path(url), ULTIMAKER2.baud_rate)
    try:
        os.write(master, b"Error:No Checksum with line number, Last Line: 4\nResend: 5\nok\n")
        send_abort_until_accepted(port, ULTIMAKER2)
        assert read_buffered_bytes(master) == 2 * ULTIMAKER2.unnumbered_abort
    finally:
        port.close()
