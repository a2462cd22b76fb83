"""Bed and filament of the emulator, and starvation by a slow host."""

from __future__ import annotations

import pytest

from printers.firmware_host import Host


@pytest.fixture
def host() -> Host:
    return Host()


def unpark_filament(host: Host) -> None:
    host.heat_nozzle()
    for line in ("G28", "G92 E0", "G1 E20 F300", "G92 E0", "M400"):
        host.send(line)


def test_unparking_filament_leaves_the_bed_clear(host: Host) -> None:
    assert host.board.filament_end_mm == -20.0
    for line in ("G28", "G1 Z5 F2400"):
        host.send(line)
    host.heat_nozzle()
    for line in ("G92 E0", "G1 E20 F300", "M400"):
        host.send(line)
    assert host.board.filament_end_mm == pytest.approx(0.0) and host.board.bed_clear


def test_extruding_over_the_bed_makes_it_not_clear_until_a_person_clears_it(host: Host) -> None:
    unpark_filament(host)
    for line in ("G1 X50 Y50 Z0.3 F9000", "G1 X100 E2 F1500", "M400"):
        host.send(line)
    assert not host.board.bed_clear
    host.firmware.reset(host.now_s)
    assert not host.board.bed_clear
    host.board.clear_bed()
    assert host.board.bed_clear


def test_purging_with_the_bed_lowered_keeps_the_bed_clear(host: Host) -> None:
    unpark_filament(host)
    host.send("G1 E30 F300")
    host.send("M400")
    assert host.board.bed_clear


def test_retraction_moves_the_filament_and_prints_nothing(host: Host) -> None:
    unpark_filament(host)
    for line in ("G1 Z0.3 F9000", "G10", "M400"):
        host.send(line)
    assert host.board.filament_end_mm == pytest.approx(-6.5)
    for line in ("G11", "M400"):
        host.send(line)
    assert host.board.filament_end_mm == pytest.approx(0.0) and host.board.bed_clear


def stream_lines(host: Host, pause_s: float) -> None:
    for k in range(1, 40):
        answers = host.send_burst(f"G1 X{50 + k} E{k * 0.05:.3f} F3000")
        while "ok" not in answers:
            answers += host.wait_until(host.firmware.compute_deadline_s())
        if k == 20:
            host.wait(pause_s)


def test_empty_queue_during_a_print_counts_as_starvation(host: Host) -> None:
    unpark_filament(host)
    host.send("G1 X50 Y50 Z0.3 F9000")
    stream_lines(host, 0.0)
    assert host.firmware.starvation_s == 0.0
    stream_lines(host, 5.0)
    assert 4.0 < host.firmware.starvation_s < 5.0
    starvation_s = host.firmware.starvation_s
    host.send("M400")
    host.wait(100.0)
    host.send("G1 X100 F3000")
    assert (
        host.firmware.starvation_s == starvation_s
    )  # a host that waits for the end of the moves does not print
