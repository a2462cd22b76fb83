"""State of the firmware between two resets: modes, position, waiting moves.

While a move waits for a free place in the planner, the firmware reads no further line.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable

from drivers.emulator.firmware import wording
from drivers.emulator.firmware.planner import CAPACITY, Limits, Planner, Point
from drivers.emulator.firmware.wording import FaultMessages
from drivers.emulator.hardware.board import EmulatedBoard

KEEP_ALIVE_INTERVAL_S = 2.0  # seconds between two busy messages after a reset
MAX_EXTRUSION_MM = 1000.0
MAX_NOZZLE_C = 275.0
DEAD_HEATER_TIMEOUT_S = 30.0  # time until the firmware detects a heater that produces no heat
SD_BYTES_PER_S = 500.0
MAX_WIRE_TIME_S = 0.010  # upper bound of a line's time on a real wire, including the answer

_NUMBER = re.compile(rb"[ \t]*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2}(?!\d))?)")


def read_value(line: bytes, letter: bytes) -> float | None:
    """Parse the number after the first `letter` in the line (``code_seen``); 0 if it has no digits."""
    index = line.find(letter)
    if index < 0:
        return None
    match = _NUMBER.match(line, index + 1)
    return float(match[1]) if match else 0.0


def read_positive_number(line: bytes, letter: bytes, default: float) -> float:
    """Parse a number as `read_value` does; return `default` unless it is above 0."""
    number = read_value(line, letter)
    return number if number is not None and number > 0.0 else default


class Machine:
    """Modes, limits, position and planner of the firmware between two resets.

    Parameters
    ----------
    board
        The board, whose coordinates are the true ones; those of the firmware differ by a shift until homing.
    send
        Function that is called with the bytes for the host.
    stop
        Function that is called with a message and the time if the firmware stops itself (``Stop()``).
    fault_messages
        Messages for faults.
    now_s
        Time of the reset, in seconds of the caller's clock, as are all times.
    """

    def __init__(
        self,
        board: EmulatedBoard,
        send: Callable[[bytes], None],
        stop: Callable[[bytes, float], None],
        fault_messages: FaultMessages,
        now_s: float,
    ) -> None:
        self.board = board
        self.fault_messages = fault_messages
        self.limits = Limits.from_profile(board.profile)
        x, y, z = board.head_position_mm
        self.planner = Planner(
            self.limits, (x, y, z, board.filament_mm), board.feed_filament, board.faults.slowdown
        )
        self.waiting_moves: deque[tuple[Point, float]] = deque()  # wait for a free place in the planner
        self.position_mm = [0.0, 0.0, 0.0, 0.0]  # target of the last move, in the host's coordinates
        self.is_homed = False
        self.is_stopped = False
        self.starvation_s = 0.0
        self.temperature_fault_s = math.inf  # time at which a heater makes the firmware stop, and the message
        self.temperature_fault_message = b""
        self.dead_man_timeout_s = math.inf  # M85: longest allowed silence of the host
        self.keep_alive_interval_s = KEEP_ALIVE_INTERVAL_S  # seconds between two busy messages
        self.dead_man_armed_at_s = now_s  # time of the M85
        self.last_command_at_s = now_s  # time at which the last command was finished
        self.send = send
        self.stop = stop
        self._sd_print: tuple[int, float] | None = None  # size of the file in bytes, and start time
        self.shift_mm = [x, y, z, board.filament_mm]  # true position minus the host's
        self.homed_axes = [False, False, False]
        self.is_relative = False
        self.is_e_relative = False
        self.feedrate_mm_s = 25.0
        self.feed_factor = 1.0
        self.flow_factor = 1.0
        self.min_extrusion_c = board.profile.min_extrusion_c
        self.retracted_mm = 0.0
        self.is_streaming = False  # a print is running: an empty queue is the host's fault
        self.max_position_mm = board.profile.max_position_mm  # soft limits

    # --- moves ---

    def move(self, line: bytes, now_s: float) -> None:
        """Execute ``G0`` or ``G1`` as ``get_coordinates`` does: a letter may stand anywhere in the line."""
        self.queue_linear_move(
            read_value(line, b"F"),
            read_value(line, b"X"),
            read_value(line, b"Y"),
            read_value(line, b"Z"),
            read_value(line, b"E"),
            now_s,
        )

    def queue_linear_move(
        self,
        f: float | None,
        x: float | None,
        y: float | None,
        z: float | None,
        e: float | None,
        now_s: float,
    ) -> None:
        """Queue one straight move.

        Parameters
        ----------
        f
            Feed rate in mm/min; None keeps the last one.
        x, y, z, e
            Target, or distance in relative mode, in mm; None if the line lacks the axis.
        now_s
            Time at which the line is executed.
        """
        if f is not None and f > 0.0:
            self.feedrate_mm_s = f / 60.0
        position, max_mm, relative = self.position_mm, self.max_position_mm, self.is_relative
        x0, y0, z0, e0 = position
        x = x0 if x is None else (x0 + x if relative else x)
        y = y0 if y is None else (y0 + y if relative else y)
        z = z0 if z is None else (z0 + z if relative else z)
        e = e0 if e is None else (e0 + e if relative or self.is_e_relative else e)
        position[0] = x = 0.0 if x < 0.0 else (x if x < max_mm[0] else max_mm[0])
        position[1] = y = 0.0 if y < 0.0 else (y if y < max_mm[1] else max_mm[1])
        position[2] = z = 0.0 if z < 0.0 else (z if z < max_mm[2] else max_mm[2])
        position[3] = e
        feedrate_mm_s = self.feedrate_mm_s
        if x != x0 or y != y0:
            feedrate_mm_s *= self.feed_factor
        self.queue(x, y, z, e - e0, feedrate_mm_s, now_s)

    def queue(self, x: float, y: float, z: float, e_mm: float, feedrate_mm_s: float, now_s: float) -> None:
        """Queue a move to `position_mm`, which the caller has updated already.

        Parameters
        ----------
        x, y, z
            The same position in mm, in the host's coordinates.
        e_mm
            Extrusion in mm.
        feedrate_mm_s
            Feed rate.
        now_s
            Time at which the line is executed.
        """
        planner, shift = self.planner, self.shift_mm
        if e_mm:
            extruded_mm = self._limit_extrusion(e_mm, now_s)
            if extruded_mm != e_mm:
                shift[3] += extruded_mm - e_mm  # counted for the host, but not extruded
        target = (x + shift[0], y + shift[1], z + shift[2], self.position_mm[3] + shift[3])
        if self.waiting_moves or len(planner) >= CAPACITY:
            self.waiting_moves.append((target, feedrate_mm_s))
            return
        if not len(planner):
            self._note_starvation(now_s)
        if e_mm > 0.0:
            self.is_streaming = True
        planner.add(target, feedrate_mm_s, now_s)

    def queue_waiting_move(self, now_s: float) -> None:
        """Pass the first waiting move to the planner, which must have a free place."""
        target, feedrate_mm_s = self.waiting_moves.popleft()
        self.planner.add(target, feedrate_mm_s, now_s)

    def _note_starvation(self, now_s: float) -> None:
        if self.is_streaming:
            since_s = max(self.planner.idle_since_s, self.last_command_at_s)
            self.starvation_s += max(0.0, now_s - since_s - MAX_WIRE_TIME_S)

    def _limit_extrusion(self, e_mm: float, now_s: float) -> float:
        """Return the extrusion that the firmware allows: 0 if the nozzle is too cold or the move too long."""
        nozzle = self.board.nozzle
        if nozzle.compute_temperature_c(now_s) < self.min_extrusion_c:
            self.send(wording.COLD_EXTRUSION)
            return 0.0
        if abs(e_mm) > MAX_EXTRUSION_MM:
            self.send(wording.LONG_EXTRUSION)
            return 0.0
        return e_mm * self.flow_factor

    def quick_stop(self, now_s: float) -> None:
        """Stop at once, drop all queued moves, and update the position (``M401``)."""
        self.waiting_moves.clear()
        position = self.planner.stop(now_s)
        self.is_streaming = False
        self.position_mm = [true - shift for true, shift in zip(position, self.shift_mm, strict=True)]

    def start_sd_print(self, file_bytes: int, now_s: float) -> None:
        """Start printing a file on the SD card."""
        self._sd_print = file_bytes, now_s

    def compute_sd_progress(self, now_s: float) -> tuple[int, int] | None:
        """Return the printed bytes and the size of the file on the SD card; None if no file is printed."""
        if self._sd_print is None:
            return None
        file_bytes, began_s = self._sd_print
        return min(file_bytes, int((now_s - began_s) * SD_BYTES_PER_S)), file_bytes

    def power_down(self, now_s: float) -> None:
        """Stop all motion, and switch motors and heaters off."""
        x, y, z, _ = self.planner.stop(now_s)
        home_mm, max_mm = self.board.profile.home_mm, self.max_position_mm
        ends_mm = [home_mm[axis] or max_mm[axis] for axis in range(3)]  # an axis may home at its maximum
        x, y, z = (min(max(value, 0.0), end) for value, end in zip((x, y, z), ends_mm, strict=True))
        self.board.head_position_mm = (x, y, z)
        self.board.switch_heaters_off(now_s)

    # --- heaters ---

    def heat_nozzle(self, target_c: float, now_s: float) -> None:
        """Set the nozzle's target, and predict whether it will trigger a temperature fault."""
        self.board.set_nozzle_target(target_c, now_s)
        if target_c <= 0.0:
            self.is_streaming = False
        self.predict_temperature_fault(now_s)

    def predict_temperature_fault(self, now_s: float) -> None:
        """Predict the time at which the nozzle will trigger a temperature fault."""
        nozzle = self.board.nozzle
        self.temperature_fault_s = math.inf
        if nozzle.is_dead and nozzle.target_c >= nozzle.compute_temperature_c(now_s):
            self.temperature_fault_s, self.temperature_fault_message = (
                now_s + DEAD_HEATER_TIMEOUT_S,
                self.fault_messages.dead_heater,
            )
        elif nozzle.is_mosfet_shorted or nozzle.target_c > MAX_NOZZLE_C:
            self.temperature_fault_s = now_s + nozzle.compute_heating_s(MAX_NOZZLE_C, now_s)
            self.temperature_fault_message = self.fault_messages.nozzle_maxtemp

    def heat_bed(self, target_c: float, now_s: float) -> None:
        """Set the bed's target."""
        self.board.set_bed_target(target_c, now_s)
