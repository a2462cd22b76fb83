"""Main loop of the firmware: bytes and the time in, bytes out; no I/O and no clock.

`EmulatedFirmware.feed` computes every event up to `now_s` at its exact time, so a late host does not prolong
a print while the planner has moves left: a move that ended at 103.2 s frees its place at 103.2 s, even if
`feed` is called at 103.4 s. `EmulatedFirmware.compute_deadline_s` is the time of the next call without bytes.

The order of events follows ``Marlin_main.cpp`` of the Ultimaker 2: ``get_command`` (`listener`) reads lines
from a ring buffer of 127 bytes into a buffer of 8 lines, and acknowledges G0-G3 there; the loop executes one
line at a time and reads no other line while it is busy. `Dialect` records how other firmwares differ.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable

from drivers.emulator.faults import SLEEP_DURATION_S, Faults
from drivers.emulator.firmware import wording
from drivers.emulator.firmware.commands import ResumeTimes, execute
from drivers.emulator.firmware.dialects import DIALECTS
from drivers.emulator.firmware.listener import Listener, Phase
from drivers.emulator.firmware.machine import Machine, read_value
from drivers.emulator.hardware.board import EmulatedBoard
from drivers.printers import Profile

BOOTLOADER_DURATION_S = 1.0  # [assumed] bytes that arrive in this time are lost
BANNER_DURATION_S = 0.036  # time from ``start`` to the end of the banner
FIRST_COMMAND_DELAY_S = 0.26  # time from the end of the banner to the first command
SD_FAILURE_DELAY_S = 2.3  # time from ``start`` to the message about the SD card
WATCHDOG_TIMEOUT_S = 4.07  # time from kill() to the reset by the watchdog


class EmulatedFirmware(Listener):
    """Firmware of one emulated printer from power-on; opening the port calls `reset`.

    Parameters
    ----------
    profile
        The printer model.
    faults
        Faults to inject.
    rng
        Random generator of the faults.
    now_s
        Time of power-on, in seconds of the caller's clock. Power-on boots the board, as a reset does.
    """

    def __init__(self, profile: Profile, faults: Faults, rng: random.Random, now_s: float) -> None:
        super().__init__(DIALECTS[profile.firmware.title], faults, rng)
        self.board = EmulatedBoard(profile, faults)
        self.reset_count = -1  # the boot at power-on does not count
        self._due_faults: dict[int, list[str]] = {}  # names of the faults by their line counts
        for name, line in faults.line_counts.items():
            self._due_faults.setdefault(line, []).append(name)
        self._asleep_until_s = -math.inf
        # Number of moves, their total duration, and seconds of starvation.
        self._totals_before_reset = (0, 0.0, 0.0)
        self._time_s = now_s
        self.machine = Machine(self.board, self._send, self.stop, self.dialect.fault_messages, now_s)
        self.reset(now_s)

    # --- interface ---

    def reset(self, now_s: float, boot_s: float = BOOTLOADER_DURATION_S) -> None:
        """Reset the board: motors and heaters go off, the state is lost, ``start`` is sent after `boot_s`."""
        old_machine = self.machine
        old_machine.power_down(now_s)
        moves, moving_s, starvation_s = self._totals_before_reset
        self._totals_before_reset = (
            moves + old_machine.planner.move_count,
            moving_s + old_machine.planner.moving_s,
            starvation_s + old_machine.starvation_s,
        )
        self.reset_count += 1
        self.board.change_count += 1
        self.phase = Phase.BOOTLOADER
        self.machine = Machine(self.board, self._send, self.stop, self.dialect.fault_messages, now_s)
        self._drop_input()
        self._running_command: ResumeTimes | None = None
        self._resume_s = math.inf
        self._stopped_number = 0  # last accepted line at the last Stop()
        self._asleep_until_s = -math.inf
        start_s = now_s + boot_s
        self._schedule: deque[tuple[float, Callable[[float], None]]] = deque(
            (
                (start_s, self._boot),
                (start_s + BANNER_DURATION_S + FIRST_COMMAND_DELAY_S, self._begin_main_loop),
                (start_s + SD_FAILURE_DELAY_S, lambda _: self._send(self.dialect.late_banner)),
            )
        )
        self._time_s = now_s

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Process bytes from the host, if any, up to `now_s`, and return the bytes for the host."""
        if self.noise is not None and data:
            data = self.noise.carry_to_board(data)
        machine = self.machine
        if (
            data
            and machine.dead_man_timeout_s < math.inf
            and self._running_command is None
            and not machine.waiting_moves
        ):
            # The bytes may have arrived before the dead-man timer expired: assume that they did, because it
            # is unknown when they arrived during the last wait.
            machine.last_command_at_s = max(
                machine.last_command_at_s, now_s - machine.dead_man_timeout_s + 1e-3
            )
        self._advance(now_s)
        if data and self.phase in (Phase.RUNNING, Phase.BOOTING):
            if not self._is_busy():
                self._time_s = now_s
            self._store_bytes(data, now_s)
        if not self._output:
            return b""
        answers = b"".join(self._output)
        self._output.clear()
        if self.phase is Phase.MUTE:
            return b""
        return answers if self.noise is None else self.noise.carry(answers)

    def compute_deadline_s(self, max_delay_s: float = 0.0) -> float:
        """Return the latest time for the next `feed`; infinite if nothing is due.

        Oks may be sent up to `max_delay_s` later while the planner remains well filled: one wake-up then
        serves several moves, and no move is delayed.
        """
        due_s = self._find_next_event_s()
        if self.phase is Phase.RUNNING:
            if self._asleep_until_s > self._time_s:
                return min(due_s, self._asleep_until_s)
            if self.machine.waiting_moves:
                planner = self.machine.planner
                free_s = planner.compute_next_free_s()
                if max_delay_s > 0.0:
                    free_s = min(free_s + max_delay_s, planner.compute_refill_s())
                return min(due_s, free_s)
            if self._running_command is not None:
                return min(due_s, self._resume_s)
        return due_s

    @property
    def move_count(self) -> int:
        """Number of moves queued since power-on."""
        return self._totals_before_reset[0] + self.machine.planner.move_count

    @property
    def moving_s(self) -> float:
        """Total duration of the finished moves since power-on, in seconds."""
        return self._totals_before_reset[1] + self.machine.planner.moving_s

    @property
    def starvation_s(self) -> float:
        """Seconds of a print in which the planner lacked lines, minus the transmission time."""
        return self._totals_before_reset[2] + self.machine.starvation_s

    # --- time ---

    def _is_busy(self) -> bool:
        return self._running_command is not None or bool(self.machine.waiting_moves)

    def _find_next_event_s(self) -> float:
        """Return the time of the next event without input."""
        due_s = self._schedule[0][0] if self._schedule else math.inf
        if self.phase in (Phase.RUNNING, Phase.MUTE):
            machine = self.machine
            due_s = min(
                due_s,
                machine.temperature_fault_s,
                self.dialect.find_inactivity_start_s(machine) + machine.dead_man_timeout_s,
            )
            if self.dialect.busy_message and self._is_busy():
                due_s = min(due_s, self._busy_message_s)
        return due_s

    def _advance(self, now_s: float) -> None:
        """Advance the state up to `now_s`."""
        while (at_s := self._find_next_event_s()) <= now_s:
            self._run_main_loop(at_s)
            if self._find_next_event_s() > at_s:
                continue  # a command that ended meanwhile has postponed the event
            if self._schedule and self._schedule[0][0] <= at_s:
                self._schedule.popleft()[1](at_s)
            elif self._busy_message_s <= at_s and self.dialect.busy_message and self._is_busy():
                self._send(self.dialect.busy_message)
                self._busy_message_s += self.machine.keep_alive_interval_s
            elif self.machine.temperature_fault_s <= at_s:
                self.stop(self.machine.temperature_fault_message, at_s)
            else:
                self.kill(at_s)
        self._run_main_loop(now_s)

    def _run_main_loop(self, now_s: float) -> None:
        """Run the main loop up to `now_s`."""
        machine = self.machine
        planner = machine.planner
        while self.phase is Phase.RUNNING:
            if self._asleep_until_s > now_s:
                break
            self._time_s = max(self._time_s, self._asleep_until_s)
            if self._receiver.ring and self.dialect.reads_while_busy and self._is_busy():
                self._get_command()
            if self._is_ok_pending and not machine.waiting_moves:
                self._is_ok_pending = False
                self._acknowledge()
            if machine.waiting_moves:
                free_s = planner.compute_next_free_s()
                if free_s > now_s:
                    break
                self._time_s = max(self._time_s, free_s)
                planner.advance(self._time_s)
                machine.queue_waiting_move(self._time_s)
                machine.last_command_at_s = self._time_s
                continue
            if self._running_command is not None:
                if self._resume_s > now_s:
                    break
                self._time_s = max(self._time_s, self._resume_s)
                planner.advance(self._time_s)
                self._continue_command()
                continue
            if self._receiver.ring:
                if not self._buffer and self._read_plain_move():
                    continue
                if len(self._buffer) < self.dialect.buffer_lines - 1:
                    self._get_command()
            if not self._buffer:
                break
            planner.advance(self._time_s)
            self._process_line(self._buffer.popleft())
            machine = self.machine  # a fault may have reset the board
            planner = machine.planner
        if not machine.waiting_moves:
            planner.advance(now_s)

    def _store_bytes(self, data: bytes, now_s: float) -> None:
        """Store bytes in the ring buffer; those that do not fit are lost."""
        while data:
            overflow = self._receiver.put(data)
            if len(overflow) == len(data):
                return
            data = overflow
            self._run_main_loop(now_s)

    # --- lines ---

    def _process_line(self, line: bytes) -> None:
        """Execute one line of the buffer."""
        machine, now_s = self.machine, self._time_s
        number = read_value(line, b"N")
        self._number = self._number if number is None else int(number)
        self._busy_message_s = now_s + machine.keep_alive_interval_s
        code = read_value(line, b"G")
        if code is not None and 0 <= int(code) <= 3 and not machine.is_stopped:
            if int(code) < 2:
                machine.move(line, now_s)
            else:
                execute(self.dialect.commands, machine, line, now_s)
            machine.last_command_at_s = now_s
            if not self.dialect.acknowledges_read_moves:
                self._end_move(self._number)
            return
        if code is not None and 0 <= int(code) <= 3:
            self._finish_command()
            return
        m_code = None if code is not None else read_value(line, b"M")
        if m_code == 105:  # does not reset the dead-man timer
            self._send(self.dialect.format_report(machine, now_s))
            return
        if m_code == 999:
            machine.is_stopped = False
            self._last_number = self._stopped_number
            self._request_resend()
        self._running_command = execute(self.dialect.commands, machine, line, now_s)
        if self.phase is not Phase.RUNNING:
            self._running_command = None
            return
        if self._running_command is None:
            self._finish_command()
        else:
            self._resume_s = now_s
            self._continue_command()

    def _continue_command(self) -> None:
        """Execute the next step of the current command."""
        assert self._running_command is not None
        resume_s = next(self._running_command, None)
        if resume_s is None:
            self._running_command = None
            self._finish_command()
        else:
            self._resume_s = resume_s

    # --- start and stop ---

    def _boot(self, now_s: float) -> None:
        self.phase = Phase.BOOTING
        limits, home_offset_hundredths_mm = self.machine.limits, self._faults.home_offset_hundredths_mm
        self._send(
            wording.START + self.dialect.format_banner(self.board.profile, limits, home_offset_hundredths_mm)
        )

    def _begin_main_loop(self, now_s: float) -> None:
        self.phase = Phase.RUNNING
        self._time_s = self.machine.last_command_at_s = now_s

    def stop(self, message: bytes, now_s: float) -> None:
        """Execute ``Stop()``: switch heaters off and refuse moves until ``M999``; halt if `Dialect.halts`."""
        machine = self.machine
        if self.dialect.halts:
            if message:
                self._report_error(message)
            self.kill(now_s)
            return
        machine.temperature_fault_s = math.inf
        self.board.switch_heaters_off(now_s)
        if message:
            self._report_error(message)
        if not machine.is_stopped:
            machine.is_stopped = True
            self._stopped_number = self._last_number
            self._report_error(b"Error:" + wording.STOPPED_MESSAGE)

    def kill(self, now_s: float) -> None:
        """Execute ``kill()``: switch everything off until the watchdog or the host resets the board."""
        self.machine.power_down(now_s)
        self._report_error(wording.KILLED_MESSAGE)
        self.phase = Phase.HALTED
        self._running_command = None
        self._schedule = deque(
            () if self.dialect.halts else ((now_s + WATCHDOG_TIMEOUT_S, self._reset_by_watchdog),)
        )

    def _reset_by_watchdog(self, now_s: float) -> None:
        self.reset(now_s, boot_s=0.0)

    def _trigger_due_faults(self) -> None:
        """Trigger the faults that are due at this line."""
        for name in self._due_faults.get(self.line_count, ()):
            self.trigger_fault(name, self._time_s)

    def trigger_fault(self, name: str, now_s: float) -> None:
        """Trigger a fault that is due at a line count, by the name of its field in `Faults`."""
        board = self.board
        match name:
            case "reset_after":
                self.reset(now_s)
            case "silent_after":
                self.phase = Phase.MUTE  # until a reset; the heaters stay on
            case "sleep_after":
                self._asleep_until_s = now_s + SLEEP_DURATION_S  # the main loop then continues
            case "stuck_after":
                self._stuck_number = self._last_number + 1  # requests the next line endlessly
            case "kill_after":
                self.kill(now_s)
            case "zero_after":
                board.set_nozzle_target(0.0, now_s)
            case "nozzle_dies_after" | "nozzle_burns_after":
                board.nozzle.compute_temperature_c(now_s)
                board.nozzle.is_dead, board.nozzle.is_mosfet_shorted = "dies" in name, "burns" in name
                self.machine.predict_temperature_fault(now_s)
            case "bed_dies_after" | "bed_burns_after":
                board.bed.compute_temperature_c(now_s)
                board.bed.is_dead, board.bed.is_mosfet_shorted = "dies" in name, "burns" in name
            case "stop_after":
                self.stop(self.dialect.fault_messages.nozzle_maxtemp, now_s)
            case "nozzle_short_after":
                self.stop(self.dialect.fault_messages.nozzle_mintemp, now_s)
            case "bed_open_after":
                self.stop(self.dialect.fault_messages.bed_maxtemp, now_s)
            case "bed_short_after":
                board.is_bed_sensor_shorted = True
                board.set_bed_target(board.bed.target_c, now_s)
            case _:
                raise AssertionError(f"fault {name} is not implemented")
