"""What a command does: the firmware's memory behind its serial link, made anew at every reset.

Commands that take their time are generators: each value that they yield is the time at which they go on.
While one of them runs, or a move waits for room in the planner, the firmware reads no further line.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterator

from drivers.emulator import wording
from drivers.emulator.board import Board
from drivers.emulator.planner import CAPACITY, Limits, Planner, Point

Work = Iterator[float]

ROOM_MM = (230.0, 224.5, 10.0)  # soft limits of X and Y; of Z this much above its home
EXTRUDE_MIN_C = 170.0
EXTRUDE_MOST_MM = 1000.0
NOZZLE_MAX_C = 275.0
BED_MAX_C = 130.0
WINDOW_C = 1.0  # TEMP_WINDOW
HYSTERESIS_C = 3.0
RESIDENCY_S = 3.0
DEAD_HEATER_S = 30.0
REPORT_S = 1.0
HOME_MM_S = (100.0, 100.0, 40.0)
BUMP_S = (0.75, 0.7)  # touching the switch again slowly: XY together, Z; makes 5.3 s from the middle
RETRACT_MM, RETRACT_MM_S = 6.5, 25.0
ARC_SEGMENT_MM = 1.0
ARC_MOST_CHORDS = 4096  # more than the longest arc over this bed needs
WIRE_S = 0.010  # what a line costs on the real wire at most, with its turnaround

_NUMBER = re.compile(rb"[ \t]*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2}(?!\d))?)")


def value(line: bytes, letter: bytes) -> float | None:
    """The number behind the first such letter anywhere in the line (``code_seen``); 0 without digits."""
    at = line.find(letter)
    if at < 0:
        return None
    found = _NUMBER.match(line, at + 1)
    return float(found[1]) if found else 0.0


def positive(line: bytes, letter: bytes, otherwise: float) -> float:
    """As `value`, where only a number above 0 makes sense."""
    number = value(line, letter)
    return number if number is not None and number > 0.0 else otherwise


class Machine:
    """Modes, limits, position and the planner of one life of the firmware, on a board that was there before.

    Parameters
    ----------
    board
        The printer. Its coordinates are the true ones; the firmware's differ by a shift until it is homed.
    say
        Called with what is sent to the host.
    now_s
        When this life began; all times are on that clock.
    """

    def __init__(self, board: Board, say: Callable[[bytes], None], now_s: float) -> None:
        self.board = board
        self.limits = Limits.of(board.profile)
        x, y, z = board.head_mm
        self.planner = Planner(self.limits, (x, y, z, board.filament_mm), board.fed)
        self.waiting: deque[tuple[Point, float]] = deque()  # moves for which the planner has no room yet
        self.at = [0.0, 0.0, 0.0, 0.0]  # target of the last move, as the host counts
        self.homed = False
        self.stopped = False
        self.starved_s = 0.0
        self.trip_s = math.inf  # when a heater will make the firmware stop, and in which words
        self.trip_words = b""
        self.dead_man_s = math.inf  # M85: longest silence of the host
        self.heard_s = now_s  # when the last command was done
        self._say = say
        self._shift = [x, y, z, board.filament_mm]  # true position less the host's
        self._homed_axes = [False, False, False]
        self._relative = False
        self._relative_e = False
        self._feedrate_mm_s = 25.0
        self._feed_factor = 1.0
        self._flow_factor = 1.0
        self._extrude_min_c = EXTRUDE_MIN_C
        self._retracted_mm = 0.0
        self._streaming = False  # a print is under way: a queue that runs dry is the host's fault
        self._top_mm = (ROOM_MM[0], ROOM_MM[1], board.profile.home_mm[2] + ROOM_MM[2])

    # --- moves ---

    def move(self, line: bytes, now_s: float) -> None:
        """``G0 G1``, as ``get_coordinates`` reads them: letters anywhere in the line."""
        self.linear(
            value(line, b"F"),
            value(line, b"X"),
            value(line, b"Y"),
            value(line, b"Z"),
            value(line, b"E"),
            now_s,
        )

    def linear(
        self,
        f: float | None,
        x: float | None,
        y: float | None,
        z: float | None,
        e: float | None,
        now_s: float,
    ) -> None:
        """Queue one straight move; None where the line does not name the axis. F in mm/min."""
        if f is not None and f > 0.0:
            self._feedrate_mm_s = f / 60.0
        at, top, relative = self.at, self._top_mm, self._relative
        x0, y0, z0, e0 = at
        x = x0 if x is None else (x0 + x if relative else x)
        y = y0 if y is None else (y0 + y if relative else y)
        z = z0 if z is None else (z0 + z if relative else z)
        e = e0 if e is None else (e0 + e if relative or self._relative_e else e)
        at[0] = x = 0.0 if x < 0.0 else (x if x < top[0] else top[0])
        at[1] = y = 0.0 if y < 0.0 else (y if y < top[1] else top[1])
        at[2] = z = 0.0 if z < 0.0 else (z if z < top[2] else top[2])
        at[3] = e
        rate = self._feedrate_mm_s
        if x != x0 or y != y0:
            rate *= self._feed_factor
        self._queue(x, y, z, e - e0, rate, now_s)

    def _queue(self, x: float, y: float, z: float, de: float, rate_mm_s: float, now_s: float) -> None:
        """Queue a move to what `at` says already; `de` is the feeder's part of it."""
        planner, shift = self.planner, self._shift
        if de:
            made = self._allowed(de, now_s)
            if made != de:
                shift[3] += made - de  # counted for the host, and not made
        target = (x + shift[0], y + shift[1], z + shift[2], self.at[3] + shift[3])
        if self.waiting or len(planner) >= CAPACITY:
            self.waiting.append((target, rate_mm_s))
            return
        if not len(planner):
            self._note_starvation(now_s)
        if de > 0.0:
            self._streaming = True
        planner.add(target, rate_mm_s, now_s)

    def release(self, now_s: float) -> None:
        """There is room for the first move that waits."""
        target, rate_mm_s = self.waiting.popleft()
        self.planner.add(target, rate_mm_s, now_s)

    def _note_starvation(self, now_s: float) -> None:
        if self._streaming:
            since_s = max(self.planner.idle_since_s, self.heard_s)
            self.starved_s += max(0.0, now_s - since_s - WIRE_S)

    def _allowed(self, de: float, now_s: float) -> float:
        """Of a feeder move, what the firmware makes: nothing where it is cold or far too long."""
        nozzle = self.board.nozzle
        if nozzle.temperature_c(now_s) < self._extrude_min_c:
            self._say(wording.COLD_EXTRUSION)
            return 0.0
        if abs(de) > EXTRUDE_MOST_MM:
            self._say(wording.LONG_EXTRUSION)
            return 0.0
        return de * self._flow_factor

    def quick_stop(self, now_s: float) -> None:
        """Stand still at once, forget all queued moves, and know where that is (``M401``)."""
        self.waiting.clear()
        here = self.planner.stop(now_s)
        self._streaming = False
        self.at = [true - shift for true, shift in zip(here, self._shift, strict=True)]

    def power_down(self, now_s: float) -> None:
        """Motors and heaters off at once: the end of this life of the firmware."""
        x, y, z, _ = self.planner.stop(now_s)
        home = self.board.profile.home_mm
        self.board.head_mm = (
            min(max(x, 0.0), ROOM_MM[0]),
            min(max(y, 0.0), home[1]),
            min(max(z, 0.0), home[2]),
        )
        self.board.heaters_off(now_s)

    # --- heaters ---

    def heat_nozzle(self, target_c: float, now_s: float) -> None:
        """Set the nozzle's target, and foresee whether that will trip a safety."""
        nozzle = self.board.nozzle
        self.board.set_nozzle(target_c, now_s)
        self.trip_s = math.inf
        if target_c <= 0.0:
            self._streaming = False
        if nozzle.dead and target_c > nozzle.temperature_c(now_s):
            self.trip_s, self.trip_words = now_s + DEAD_HEATER_S, b""
        elif target_c > NOZZLE_MAX_C:
            self.trip_s = now_s + nozzle.seconds_to(NOZZLE_MAX_C, now_s)
            self.trip_words = wording.NOZZLE_MAXTEMP

    def heat_bed(self, target_c: float, now_s: float) -> None:
        self.board.set_bed(target_c, now_s)

    # --- commands; execute() finds them by their code ---

    def execute(self, line: bytes, now_s: float) -> Work | None:
        """Carry out any line but G0 and G1.

        Returns
        -------
        iterator of float or None
            The times at which a command that is not done yet goes on; None where it is done.
        """
        for letter, commands in ((b"G", _G), (b"M", _M)):
            code = value(line, letter)
            if code is not None:
                command = commands.get(int(code))
                return command(self, line, now_s) if command is not None else None
        extruder = value(line, b"T")
        if extruder is None:
            self._say(wording.unknown(line))
        elif extruder == 0:
            self._say(b"echo:Active Extruder: 0\n")
        else:
            self._say(b"echo:T%cInvalid extruder\n" % (int(extruder) & 0xFF))
        return None

    def _settled(self) -> Work:
        """Wait until the planner is empty (``st_synchronize``); the main loop advances it at each step."""
        while len(self.planner):
            yield self.planner.end_s

    def _dwell(self, line: bytes, now_s: float) -> Work:
        yield from self._settled()
        begin_s = max(now_s, self.planner.idle_since_s)
        pause_s = (value(line, b"P") or 0.0) / 1000.0
        seconds = value(line, b"S")
        self.heard_s = begin_s
        yield begin_s + max(0.0, seconds if seconds is not None else pause_s)

    def _home(self, line: bytes, now_s: float) -> Work:
        yield from self._settled()
        begin_s = max(now_s, self.planner.idle_since_s)
        named = [letter in line for letter in (b"X", b"Y", b"Z")]
        axes = named if any(named) else [True, True, True]
        home = self.board.profile.home_mm
        x, y, z, e = self.planner.target
        here = [x, y, z]
        way_s = [abs(h - p) / v for h, p, v in zip(home, here, HOME_MM_S, strict=True)]
        took_s = 0.0
        if axes[0] or axes[1]:
            took_s += max(t for t, axis in zip(way_s[:2], axes[:2], strict=True) if axis) + BUMP_S[0]
        if axes[2]:
            took_s += way_s[2] + BUMP_S[1]
        yield begin_s + took_s
        for i in range(3):
            if axes[i]:
                here[i] = self.at[i] = home[i]
                self._shift[i] = 0.0
                self._homed_axes[i] = True
        self.homed = all(self._homed_axes)
        self.planner.place((here[0], here[1], here[2], e), begin_s + took_s)
        self.board.changes += 1

    def _arc(self, line: bytes, now_s: float) -> None:
        """``G2 G3`` with I and J, cut into chords of 1 mm (``mc_arc``)."""
        f, i, j = value(line, b"F"), value(line, b"I") or 0.0, value(line, b"J") or 0.0
        if f is not None and f > 0.0:
            self._feedrate_mm_s = f / 60.0
        start = tuple(self.at)
        goal = list(start)
        for axis, letter in enumerate((b"X", b"Y", b"Z", b"E")):
            number = value(line, letter)
            if number is not None:
                relative = self._relative or (axis == 3 and self._relative_e)
                goal[axis] = start[axis] + number if relative else number
        centre_x, centre_y = start[0] + i, start[1] + j
        to_x, to_y = goal[0] - centre_x, goal[1] - centre_y
        turn = math.atan2(-i * to_y + j * to_x, -i * to_x - j * to_y)
        if value(line, b"G") == 2:
            turn = turn - 2 * math.pi if turn >= 0 else turn
        else:
            turn = turn + 2 * math.pi if turn <= 0 else turn
        radius_mm = math.hypot(i, j)
        way_mm = math.hypot(turn * radius_mm, goal[2] - start[2])
        chords = max(1, min(ARC_MOST_CHORDS, int(way_mm / ARC_SEGMENT_MM)))
        first = math.atan2(-j, -i)
        modes, self._relative, self._relative_e = (self._relative, self._relative_e), False, False
        for k in range(1, chords):
            part = k / chords
            self.linear(
                None,
                centre_x + radius_mm * math.cos(first + turn * part),
                centre_y + radius_mm * math.sin(first + turn * part),
                start[2] + (goal[2] - start[2]) * part,
                start[3] + (goal[3] - start[3]) * part,
                now_s,
            )
        self.linear(None, goal[0], goal[1], goal[2], goal[3], now_s)
        self._relative, self._relative_e = modes

    def _retract(self, line: bytes, now_s: float) -> None:
        back = value(line, b"G") == 10
        if back == bool(self._retracted_mm):
            return
        self._retracted_mm = RETRACT_MM if back else 0.0
        x, y, z, _ = self.at
        way_mm = -RETRACT_MM if back else RETRACT_MM
        self._shift[3] += way_mm  # the host's own count stays
        self._queue(x, y, z, way_mm, RETRACT_MM_S, now_s)

    def _absolute(self, line: bytes, now_s: float) -> None:
        self._relative = value(line, b"G") == 91

    def _extruder_mode(self, line: bytes, now_s: float) -> None:
        self._relative_e = value(line, b"M") == 83

    def _set_position(self, line: bytes, now_s: float) -> Work:
        if b"E" not in line:
            yield from self._settled()
        for axis, letter in enumerate((b"X", b"Y", b"Z", b"E")):
            number = value(line, letter)
            if number is not None:
                self._shift[axis] += self.at[axis] - number
                self.at[axis] = number

    def _hang(self, line: bytes, now_s: float) -> Work:
        while True:  # M0 and M1 never come back over USB
            yield math.inf

    def _motors_off(self, line: bytes, now_s: float) -> Work:
        if b"S" not in line:
            yield from self._settled()
            self._streaming = False

    def _finish(self, line: bytes, now_s: float) -> Work:
        yield from self._settled()
        self._streaming = False

    def _stop_moves(self, line: bytes, now_s: float) -> None:
        self.quick_stop(now_s)

    def _dead_man(self, line: bytes, now_s: float) -> None:
        seconds = value(line, b"S")
        if seconds is not None:
            self.dead_man_s = seconds if seconds > 0.0 else math.inf

    def _set_nozzle(self, line: bytes, now_s: float) -> None:
        target_c = value(line, b"S")
        if target_c is not None:
            self.heat_nozzle(target_c, now_s)

    def _set_bed(self, line: bytes, now_s: float) -> None:
        target_c = value(line, b"S")
        if target_c is not None:
            self.heat_bed(target_c, now_s)

    def _wait_nozzle(self, line: bytes, now_s: float) -> Work:
        """``M109``: up or down to the target, then 3 s within 3 degrees of it; a report each second."""
        nozzle = self.board.nozzle
        self._set_nozzle(line, now_s)
        heating = nozzle.temperature_c(now_s) < nozzle.target_c
        report_s, there_s = now_s + REPORT_S, math.inf
        while True:
            is_c, target_c = nozzle.temperature_c(now_s), nozzle.target_c
            if there_s == math.inf:
                arrived = is_c >= target_c - WINDOW_C if heating else is_c <= target_c + WINDOW_C
                if arrived:
                    there_s = now_s
            elif target_c > 0.0 and abs(is_c - target_c) > HYSTERESIS_C:
                there_s = now_s
            if now_s >= there_s + RESIDENCY_S:
                break
            if now_s >= report_s:
                left = b"?" if there_s == math.inf else b"%d" % int(there_s + RESIDENCY_S - now_s)
                self._say(b"T:%.1f E:0 W:%b\n" % (is_c, left))
                report_s = now_s + REPORT_S
            if there_s < math.inf:
                next_s = there_s + RESIDENCY_S
            elif heating:
                next_s = now_s + nozzle.seconds_to(target_c - WINDOW_C, now_s)
            else:
                next_s = now_s + nozzle.seconds_down_to(target_c + WINDOW_C, now_s)
            now_s = min(report_s, max(next_s, now_s + 0.001))
            yield now_s

    def _wait_bed(self, line: bytes, now_s: float) -> Work:
        """``M190``: up to the target, at once when it is hotter; a report each second."""
        bed = self.board.bed
        self._set_bed(line, now_s)
        report_s = now_s + REPORT_S
        while bed.temperature_c(now_s) < bed.target_c - WINDOW_C:
            if now_s >= report_s:
                nozzle_c = self.board.nozzle.temperature_c(now_s)
                self._say(b"T:%.2f E:0 B:%.1f\n" % (nozzle_c, bed.temperature_c(now_s)))
                report_s = now_s + REPORT_S
            arrive_s = now_s + bed.seconds_to(bed.target_c - WINDOW_C, now_s)
            now_s = min(report_s, max(arrive_s, now_s + 0.001))
            yield now_s

    def temperatures(self, now_s: float) -> bytes:
        """The answer to ``M105``, with its ok in front."""
        nozzle, bed = self.board.nozzle, self.board.bed
        return b"ok T:%.1f /%.1f B:%.1f /%.1f @:%d B@:%d\n" % (
            nozzle.temperature_c(now_s),
            nozzle.target_c,
            bed.temperature_c(now_s),
            bed.target_c,
            nozzle.power(now_s),
            bed.power(now_s),
        )

    def _report_position(self, line: bytes, now_s: float) -> None:
        here = [a - b for a, b in zip(self.planner.position(now_s), self._shift, strict=True)]
        self._say(
            b"X:%.2fY:%.2fZ:%.2fE:%.2f Count X: %.2fY:%.2fZ:%.2f\n"
            % (*map(_zero, self.at), *map(_zero, here[:3]))
        )

    def _report_endstops(self, line: bytes, now_s: float) -> None:
        # No newline at its end: the ok is glued on, as in the firmware.
        x, y, z, _ = self.planner.position(now_s)
        home = self.board.profile.home_mm
        hit = [b"TRIGGERED" if touched else b"open" for touched in (x < home[0], y > home[1], z > home[2])]
        self._say(b"Reporting endstop status\nx_min: %by_max: %bz_max: %b" % (hit[0], hit[1], hit[2]))

    def _report_card(self, line: bytes, now_s: float) -> None:
        self._say(b"Not SD printing\nCard error:1\n")

    def _list_card(self, line: bytes, now_s: float) -> None:
        self._say(b"Begin file list\nEnd file list\n")

    def _init_card(self, line: bytes, now_s: float) -> Work:
        yield now_s + 2.0
        self._say(wording.SD_FAIL)

    def _identify(self, line: bytes, now_s: float) -> None:
        self._say(wording.IDENTITY)

    def _report_settings(self, line: bytes, now_s: float) -> None:
        self._say(wording.settings(self.limits))

    def _beep(self, line: bytes, now_s: float) -> Work:
        yield now_s + positive(line, b"P", 0.0) / 1000.0

    def _park(self, line: bytes, now_s: float) -> Work:
        """``M601`` outside an SD print: bed down, head away, no waiting for a person."""
        yield from self._settled()
        now_s = max(now_s, self.planner.idle_since_s)
        x, y, z, e = self.at
        z = min(z + 20.0, self._top_mm[2])
        self.at = [10.0, 10.0, z, e]
        self._queue(x, y, z, 0.0, 35.0, now_s)
        self._queue(10.0, 10.0, z, 0.0, 150.0, now_s)
        yield from self._settled()

    def _set_limits(self, line: bytes, now_s: float) -> None:
        limits, code = self.limits, int(value(line, b"M") or 0)
        per_axis = {92: limits.steps_per_mm, 201: limits.acceleration_mm_s2, 203: limits.feedrate_mm_s}
        if code in per_axis:
            for axis, letter in enumerate((b"X", b"Y", b"Z", b"E")):
                per_axis[code][axis] = positive(line, letter, per_axis[code][axis])
        elif code == 204:
            limits.print_mm_s2 = positive(line, b"S", limits.print_mm_s2)
            limits.retract_mm_s2 = positive(line, b"T", limits.retract_mm_s2)
        else:
            limits.jerk_xy_mm_s = positive(line, b"X", limits.jerk_xy_mm_s)
            limits.jerk_z_mm_s = positive(line, b"Z", limits.jerk_z_mm_s)
            limits.jerk_e_mm_s = positive(line, b"E", limits.jerk_e_mm_s)

    def _set_feed_factor(self, line: bytes, now_s: float) -> None:
        self._feed_factor = positive(line, b"S", 100.0 * self._feed_factor) / 100.0

    def _set_flow_factor(self, line: bytes, now_s: float) -> None:
        self._flow_factor = positive(line, b"S", 100.0 * self._flow_factor) / 100.0

    def _allow_cold(self, line: bytes, now_s: float) -> None:
        self._extrude_min_c = value(line, b"S") or 0.0


def _zero(number: float) -> float:
    """Never minus nothing."""
    return 0.0 if abs(number) < 0.005 else number


Command = Callable[[Machine, bytes, float], Work | None]

_G: dict[int, Command] = {
    2: Machine._arc,
    3: Machine._arc,
    4: Machine._dwell,
    10: Machine._retract,
    11: Machine._retract,
    28: Machine._home,
    90: Machine._absolute,
    91: Machine._absolute,
    92: Machine._set_position,
}
# Codes that change nothing here (fan, light, SD card, text) and those that it does not know: plain ok.
_M: dict[int, Command] = {
    0: Machine._hang,
    1: Machine._hang,
    18: Machine._motors_off,
    20: Machine._list_card,
    21: Machine._init_card,
    27: Machine._report_card,
    82: Machine._extruder_mode,
    83: Machine._extruder_mode,
    84: Machine._motors_off,
    85: Machine._dead_man,
    92: Machine._set_limits,
    104: Machine._set_nozzle,
    109: Machine._wait_nozzle,
    114: Machine._report_position,
    115: Machine._identify,
    119: Machine._report_endstops,
    140: Machine._set_bed,
    190: Machine._wait_bed,
    201: Machine._set_limits,
    203: Machine._set_limits,
    204: Machine._set_limits,
    205: Machine._set_limits,
    220: Machine._set_feed_factor,
    221: Machine._set_flow_factor,
    300: Machine._beep,
    302: Machine._allow_cold,
    400: Machine._finish,
    401: Machine._stop_moves,
    503: Machine._report_settings,
    601: Machine._park,
}
