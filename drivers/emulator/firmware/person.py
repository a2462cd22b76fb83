"""Actions of a person at the printer's own display, which the firmware does not report to the host. Pure."""

from __future__ import annotations

from drivers.emulator.firmware.firmware import EmulatedFirmware

SD_FILE_BYTES = 5_000_000
SD_NOZZLE_C, SD_BED_C = 210.0, 60.0


def set_nozzle_target(firmware: EmulatedFirmware, target_c: float, now_s: float) -> None:
    """Set the nozzle's target with the knob."""
    firmware.feed(b"", now_s)
    firmware.machine.heat_nozzle(target_c, now_s)


def set_bed_target(firmware: EmulatedFirmware, target_c: float, now_s: float) -> None:
    """Set the bed's target with the knob."""
    firmware.feed(b"", now_s)
    firmware.machine.heat_bed(target_c, now_s)


def move_bed(firmware: EmulatedFirmware, z_mm: float, now_s: float) -> None:
    """Raise or lower the bed."""
    firmware.feed(b"", now_s)
    firmware.machine.queue_linear_move(1200.0, None, None, z_mm, None, now_s)


def print_sd(firmware: EmulatedFirmware, now_s: float) -> None:
    """Print from the SD card: heat, move, and report the progress in M27."""
    set_nozzle_target(firmware, SD_NOZZLE_C, now_s)
    set_bed_target(firmware, SD_BED_C, now_s)
    firmware.machine.start_sd_print(SD_FILE_BYTES, now_s)
    firmware.machine.queue_linear_move(9000.0, 100.0, 100.0, 20.0, None, now_s)
