"""Answers of emulated firmwares to queries. Pure."""

from __future__ import annotations

from drivers.emulator.firmware.machine import Machine


def format_temperatures(machine: Machine, now_s: float, decimals: int = 1) -> bytes:
    """Format the answer to ``M105``, which begins with the ok."""
    nozzle, bed = machine.board.nozzle, machine.board.bed
    return b"ok T:%.*f /%.*f B:%.*f /%.*f @:%d B@:%d\n" % (
        decimals,
        nozzle.compute_temperature_c(now_s),
        decimals,
        nozzle.target_c,
        decimals,
        machine.board.read_bed_c(now_s),
        decimals,
        bed.target_c,
        nozzle.compute_power(now_s),
        bed.compute_power(now_s),
    )


def report_position(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M114``: the end of the planned moves, and the position of the head in mm."""
    position = [a - b for a, b in zip(machine.planner.compute_position(now_s), machine.shift_mm, strict=True)]
    machine.send(
        b"X:%.2fY:%.2fZ:%.2fE:%.2f Count X: %.2fY:%.2fZ:%.2f\n"
        % (*map(_drop_sign_of_zero, machine.position_mm), *map(_drop_sign_of_zero, position[:3]))
    )


def report_endstops(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M119`` without a newline at the end, as in the firmware: the ok follows on the same line."""
    x, y, z, _ = machine.planner.compute_position(now_s)
    home_mm = machine.board.profile.home_mm
    is_pressed = (x < home_mm[0], y > home_mm[1], z > home_mm[2])
    states = [b"TRIGGERED" if pressed else b"open" for pressed in is_pressed]
    machine.send(b"Reporting endstop status\nx_min: %by_max: %bz_max: %b" % (states[0], states[1], states[2]))


def report_sd_progress(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M27``: the progress of an SD print."""
    progress = machine.compute_sd_progress(now_s)
    machine.send(
        b"SD printing byte %d/%d\n" % progress if progress is not None else b"Not SD printing\nCard error:1\n"
    )


def list_sd_files(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M20``: the list of files of an empty card."""
    machine.send(b"Begin file list\nEnd file list\n")


def _drop_sign_of_zero(number: float) -> float:
    """Return 0 for a number that two decimals show as zero."""
    return 0.0 if abs(number) < 0.005 else number
