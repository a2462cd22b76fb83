"""What goes wrong on the board at a line of its own, once. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.emulator import wording

if TYPE_CHECKING:
    from drivers.emulator.firmware import Firmware


def happen(name: str, firmware: Firmware, now_s: float) -> None:
    """Let one of the faults happen that count lines; `name` is that of its field in `Faults`."""
    board = firmware.board
    match name:
        case "reset_after":
            firmware.reset(now_s)
        case "silent_after":
            firmware.fall_silent()
        case "sleep_after":
            firmware.sleep(now_s)
        case "stuck_after":
            firmware.stick()
        case "kill_after":
            firmware.kill(now_s)
        case "zero_after":
            board.set_nozzle(0.0, now_s)
        case "nozzle_dies_after" | "nozzle_burns_after":
            board.nozzle.temperature_c(now_s)
            board.nozzle.dead, board.nozzle.burns = "dies" in name, "burns" in name
            firmware.machine.foresee(now_s)
        case "bed_dies_after" | "bed_burns_after":
            board.bed.temperature_c(now_s)
            board.bed.dead, board.bed.burns = "dies" in name, "burns" in name
        case "stop_after":
            firmware.stop(wording.NOZZLE_MAXTEMP, now_s)
        case "nozzle_short_after":
            firmware.stop(wording.NOZZLE_MINTEMP, now_s)
        case "bed_open_after":
            firmware.stop(wording.BED_MAXTEMP, now_s)
        case "bed_short_after":
            board.bed_shorted = True
            board.set_bed(board.bed.target_c, now_s)
        case _:
            raise AssertionError(f"nobody knows how {name} happens")
