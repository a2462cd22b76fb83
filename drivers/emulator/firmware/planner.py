"""Look-ahead planner of the firmware, with computed times of moves instead of time steps.

It follows ``planner.cpp`` of the 2+ firmware (Marlin 1.0): blocks are trapezoids of constant acceleration.
The jerk of XY, Z and E bounds the speed at a junction. A reverse and a forward pass over the queue bound each
entry speed by those of its neighbours, and the queue must always be able to end at a stop. A block's speeds
are fixed when it starts. Rounding to whole steps is omitted. ``SLOWDOWN`` (short moves are slowed down while
the queue runs low) is off by default: it reacts to a late host, and an accelerated clock makes the host late.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.printers import Profile

# Moves that fit in the queue before the next one has to wait: 17 are acknowledged at once
# (docs/explanation/ultimaker2-serial.md, section 2).
CAPACITY = 16
STANDSTILL_MM_S = 0.05  # MINIMUM_PLANNER_SPEED: below this the firmware treats the head as stopped
SHORT_MOVE_S = 0.020  # M205 B: shorter moves are slowed down while the queue is less than half full
MIN_STEPS = 5  # shorter moves are not executed, but added to the next one

Point = tuple[float, float, float, float]  # x, y, z, e in mm


@dataclass(slots=True)
class Limits:
    """Limits that ``M92``, ``M201`` and ``M203`` to ``M205`` set, as the firmware holds them after a boot."""

    feedrate_mm_s: list[float]
    acceleration_mm_s2: list[float]
    print_acceleration_mm_s2: float
    retract_acceleration_mm_s2: float
    jerk_xy_mm_s: float
    jerk_z_mm_s: float
    jerk_e_mm_s: float
    steps_per_mm: list[float]

    @classmethod
    def from_profile(cls, profile: Profile) -> Limits:
        """Return the limits of a printer model after a boot."""
        xy, z, e = profile.jerk_mm_s
        return cls(
            list(profile.max_feedrate_mm_s),
            list(profile.max_acceleration_mm_s2),
            profile.acceleration_mm_s2,
            profile.acceleration_mm_s2,
            xy,
            z,
            e,
            list(profile.steps_per_mm),
        )


class Block:
    """One queued move. Most speeds are stored squared (``_mm2_s2``), which saves square roots.

    Attributes
    ----------
    target_mm
        Position at the end of the move.
    e_mm, length_mm
        Extrusion, and length of the path.
    speed_mm_s, acceleration_mm_s2
        Nominal speed and acceleration.
    gain_mm2_s2
        Largest change of the squared speed over the block.
    max_entry_mm2_s2, entry_mm2_s2
        Upper bound of the squared entry speed, and its current value.
    """

    __slots__ = (
        "acceleration_mm_s2",
        "e_mm",
        "entry_mm2_s2",
        "gain_mm2_s2",
        "length_mm",
        "max_entry_mm2_s2",
        "speed_mm_s",
        "target_mm",
    )

    def __init__(
        self,
        target: Point,
        e_mm: float,
        length_mm: float,
        speed_mm_s: float,
        acceleration_mm_s2: float,
        max_entry_mm_s: float,
    ) -> None:
        self.target_mm = target
        self.e_mm = e_mm
        self.length_mm = length_mm
        self.speed_mm_s = speed_mm_s
        self.acceleration_mm_s2 = acceleration_mm_s2
        self.gain_mm2_s2 = 2.0 * acceleration_mm_s2 * length_mm
        self.max_entry_mm2_s2 = max_entry_mm_s * max_entry_mm_s
        self.entry_mm2_s2 = min(self.max_entry_mm2_s2, STANDSTILL_MM_S * STANDSTILL_MM_S + self.gain_mm2_s2)


class Planner:
    """Queue of moves. Times are in seconds of the caller's clock and never decrease.

    Parameters
    ----------
    limits
        Limits of the firmware; read at every move, as M-codes may change them.
    start
        Position of head and feeder.
    on_move
        Function that is called with (e_mm, z_mm) for every finished move that turned the feeder.
    slowdown
        True if short moves are slowed down while the queue runs low.
    """

    def __init__(
        self,
        limits: Limits,
        start: Point,
        on_move: Callable[[float, float], None],
        slowdown: bool = False,
    ) -> None:
        self.limits = limits
        self._slows_short_moves = slowdown
        self.target_mm = start  # target of the last queued move
        self.move_count = 0  # number of moves queued since the start
        self.moving_s = 0.0  # total duration of the finished moves
        self.idle_since_s = 0.0  # time at which the queue became empty; undefined while it has moves
        self._head_position_mm = start  # position at which the executing block began
        self._on_move = on_move
        self._blocks: list[Block] = []
        self._final_count = 1  # number of front blocks whose entry speed is final
        self._start_s = 0.0  # start and end of the executing block
        self._end_s = 0.0
        # Executing block: entry and top speed in mm/s, seconds of acceleration and at top speed.
        self._ramps = (0.0, 0.0, 0.0, 0.0)
        self._axis_speeds_mm_s = (0.0, 0.0, 0.0, 0.0)  # of the last queued move
        self._speed_mm_s = 0.0

    def __len__(self) -> int:
        return len(self._blocks)

    def compute_next_free_s(self) -> float:
        """Return the time at which a further move fits; minus infinity if one fits at once."""
        return self._end_s if len(self._blocks) >= CAPACITY else -math.inf

    def advance(self, now_s: float) -> None:
        """Finish all moves that end by `now_s`."""
        blocks = self._blocks
        while blocks and self._end_s <= now_s:
            block = blocks.pop(0)
            self._head_position_mm = block.target_mm
            self.moving_s += self._end_s - self._start_s
            if block.e_mm:
                self._on_move(block.e_mm, block.target_mm[2])
            if blocks:
                self._begin_block(self._end_s)
            else:
                self.idle_since_s = self._end_s

    def compute_refill_s(self) -> float:
        """Return a time at which the full queue still holds three quarters of its moves."""
        return self._end_s + sum(
            [block.length_mm / block.speed_mm_s for block in self._blocks[1 : CAPACITY // 4]]
        )

    @property
    def end_s(self) -> float:
        """Time at which the executing move ends; the queue must not be empty."""
        return self._end_s

    def add(self, target_mm: Point, feedrate_mm_s: float, now_s: float) -> None:
        """Queue a straight move. The queue must have a free place and be advanced to `now_s`.

        Parameters
        ----------
        target_mm
            Position of head and feeder at the end of the move, in mm.
        feedrate_mm_s
            Feed rate, before the limits apply.
        now_s
            Time at which the move is queued.
        """
        x0, y0, z0, e0 = self.target_mm
        x, y, z, e = target_mm
        dx, dy, dz, de = x - x0, y - y0, z - z0, e - e0
        limits = self.limits
        length_mm = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length_mm < 0.07:
            length_mm = self._measure_short_move(dx, dy, dz, de, length_mm)
            if not length_mm:
                return
        inverse_duration_per_s = feedrate_mm_s / length_mm
        if self._slows_short_moves:
            inverse_duration_per_s = self._slow_short_move(inverse_duration_per_s)
        if dz or feedrate_mm_s > 200.0 or abs(de) > length_mm * 0.1:
            for d, max_mm_s in zip((dx, dy, dz, de), limits.feedrate_mm_s, strict=True):
                if abs(d) * inverse_duration_per_s > max_mm_s:
                    inverse_duration_per_s = max_mm_s / abs(d)
        vx, vy, vz, ve = (
            dx * inverse_duration_per_s,
            dy * inverse_duration_per_s,
            dz * inverse_duration_per_s,
            de * inverse_duration_per_s,
        )
        speed_mm_s = length_mm * inverse_duration_per_s
        acceleration_mm_s2 = (
            limits.print_acceleration_mm_s2 if dx or dy or dz else limits.retract_acceleration_mm_s2
        )
        if dz or abs(de) > length_mm * 0.5 or acceleration_mm_s2 > 4000.0:
            acceleration_mm_s2 = self._limit_acceleration(dx, dy, dz, de, length_mm, acceleration_mm_s2)
        max_entry_mm_s = self._limit_junction_speed(vx, vy, vz, ve, speed_mm_s)
        self._append_block(
            Block(target_mm, de, length_mm, speed_mm_s, acceleration_mm_s2, max_entry_mm_s), now_s
        )
        self.target_mm = target_mm
        self._axis_speeds_mm_s = (vx, vy, vz, ve)
        self._speed_mm_s = speed_mm_s
        self.move_count += 1

    def _measure_short_move(self, dx: float, dy: float, dz: float, de: float, length_mm: float) -> float:
        """Return the length of a move, along the filament if only the feeder moves; 0 for too few steps."""
        per_mm = self.limits.steps_per_mm
        head_steps = max(abs(dx) * per_mm[0], abs(dy) * per_mm[1], abs(dz) * per_mm[2])
        if head_steps > MIN_STEPS:
            return length_mm
        return abs(de) if abs(de) * per_mm[3] > MIN_STEPS else 0.0

    def _slow_short_move(self, inverse_duration_per_s: float) -> float:
        """Lower the inverse duration of a short move while the queue is less than half full."""
        queue_length = len(self._blocks)
        if 1 < queue_length < CAPACITY // 2 and inverse_duration_per_s > 1.0 / SHORT_MOVE_S:
            duration_s = 1.0 / inverse_duration_per_s
            return 1.0 / (duration_s + 2.0 * (SHORT_MOVE_S - duration_s) / queue_length)
        return inverse_duration_per_s

    def compute_position(self, now_s: float) -> Point:
        """Compute the position of head and feeder; the queue must be advanced to `now_s`."""
        if not self._blocks:
            return self._head_position_mm
        block = self._blocks[0]
        entry_mm_s, top_mm_s, acceleration_time_s, cruise_s = self._ramps
        elapsed_s = now_s - self._start_s
        ramp_s = min(elapsed_s, acceleration_time_s)
        distance_mm = entry_mm_s * ramp_s + 0.5 * block.acceleration_mm_s2 * ramp_s**2
        if elapsed_s > acceleration_time_s:
            distance_mm += top_mm_s * min(elapsed_s - acceleration_time_s, cruise_s)
        if elapsed_s > acceleration_time_s + cruise_s:
            deceleration_time_s = elapsed_s - acceleration_time_s - cruise_s
            distance_mm += (
                top_mm_s * deceleration_time_s - 0.5 * block.acceleration_mm_s2 * deceleration_time_s**2
            )
        fraction = min(1.0, max(0.0, distance_mm / block.length_mm))
        x, y, z, e = (
            a + (b - a) * fraction for a, b in zip(self._head_position_mm, block.target_mm, strict=True)
        )
        return (x, y, z, e)

    def stop(self, now_s: float) -> Point:
        """Stop at once and drop the queue (``quickStop``, a reset); return the position of the head."""
        self.advance(now_s)
        position = self.compute_position(now_s)
        if self._blocks:
            self.moving_s += now_s - self._start_s
            if position[3] != self._head_position_mm[3]:
                self._on_move(position[3] - self._head_position_mm[3], position[2])
        self._blocks.clear()
        self.set_position(position, now_s)
        return position

    def set_position(self, position: Point, now_s: float) -> None:
        """Set the position of the empty queue, after homing."""
        self.target_mm = self._head_position_mm = position
        self.idle_since_s = now_s

    def _limit_acceleration(
        self, dx: float, dy: float, dz: float, de: float, length_mm: float, acceleration_mm_s2: float
    ) -> float:
        """Limit the acceleration as the firmware does: by steps, relative to the axis with the most steps."""
        limits = self.limits
        steps = [abs(d) * per_mm for d, per_mm in zip((dx, dy, dz, de), limits.steps_per_mm, strict=True)]
        max_steps = max(steps)
        acceleration_steps_s2 = acceleration_mm_s2 * max_steps / length_mm
        for count, per_mm, limit_mm_s2 in zip(
            steps, limits.steps_per_mm, limits.acceleration_mm_s2, strict=True
        ):
            if acceleration_steps_s2 * count > limit_mm_s2 * per_mm * max_steps:
                acceleration_steps_s2 = limit_mm_s2 * per_mm
        return acceleration_steps_s2 * length_mm / max_steps

    def _limit_junction_speed(self, vx: float, vy: float, vz: float, ve: float, speed_mm_s: float) -> float:
        """Compute the highest entry speed of the new move, in mm/s."""
        limits = self.limits
        if len(self._blocks) > 1:
            px, py, pz, pe = self._axis_speeds_mm_s
            jx, jy = vx - px, vy - py
            factor = 1.0
            jerk = math.sqrt(jx * jx + jy * jy)
            if jerk > limits.jerk_xy_mm_s:
                factor = limits.jerk_xy_mm_s / jerk
            jerk = abs(vz - pz)
            if jerk > limits.jerk_z_mm_s:
                factor = min(factor, limits.jerk_z_mm_s / jerk)
            jerk = abs(ve - pe)
            if jerk > limits.jerk_e_mm_s:
                factor = min(factor, limits.jerk_e_mm_s / jerk)
            return min(self._speed_mm_s, speed_mm_s * factor)
        safe_mm_s = min(speed_mm_s, limits.jerk_xy_mm_s / 2)
        if abs(vz) > limits.jerk_z_mm_s / 2:
            safe_mm_s = min(safe_mm_s, limits.jerk_z_mm_s / 2)
        if abs(ve) > limits.jerk_e_mm_s / 2:
            safe_mm_s = min(safe_mm_s, limits.jerk_e_mm_s / 2)
        return safe_mm_s

    def _append_block(self, block: Block, now_s: float) -> None:
        blocks = self._blocks
        blocks.append(block)
        last = len(blocks) - 1
        if last == 0:
            self._begin_block(now_s)
            return
        index = last
        entry_mm2_s2 = block.entry_mm2_s2
        while index > self._final_count:  # reverse: the highest speed from which later moves can brake
            previous = blocks[index - 1]
            if previous.entry_mm2_s2 >= previous.max_entry_mm2_s2:
                break
            entry_mm2_s2 = min(previous.max_entry_mm2_s2, entry_mm2_s2 + previous.gain_mm2_s2)
            if entry_mm2_s2 <= previous.entry_mm2_s2:
                break
            previous.entry_mm2_s2 = entry_mm2_s2
            index -= 1
        for i in range(index, last + 1):  # forward: the highest speed that the preceding moves can reach
            previous = blocks[i - 1]
            reach_mm2_s2 = previous.entry_mm2_s2 + previous.gain_mm2_s2
            if blocks[i].entry_mm2_s2 > reach_mm2_s2:
                blocks[i].entry_mm2_s2 = reach_mm2_s2

    def _begin_block(self, now_s: float) -> None:
        """Start the first block, which exits at the entry speed of the next one."""
        blocks = self._blocks
        block = blocks[0]
        if len(blocks) > 1:
            exit_mm2_s2 = blocks[1].entry_mm2_s2
            self._final_count = 2
        else:
            exit_mm2_s2 = min(STANDSTILL_MM_S, block.speed_mm_s) ** 2
            self._final_count = 1
        entry_mm2_s2 = block.entry_mm2_s2
        entry_mm_s, exit_mm_s = math.sqrt(entry_mm2_s2), math.sqrt(exit_mm2_s2)
        top_mm_s, acceleration_mm_s2 = block.speed_mm_s, block.acceleration_mm_s2
        cruise_mm = block.length_mm - (2.0 * top_mm_s * top_mm_s - entry_mm2_s2 - exit_mm2_s2) / (
            2.0 * acceleration_mm_s2
        )
        if cruise_mm < 0.0:  # the block is too short to reach its nominal speed
            peak_mm2_s2 = 0.5 * (block.gain_mm2_s2 + entry_mm2_s2 + exit_mm2_s2)
            top_mm_s = math.sqrt(max(peak_mm2_s2, entry_mm2_s2, exit_mm2_s2))
            cruise_mm = 0.0
        acceleration_time_s = (top_mm_s - entry_mm_s) / acceleration_mm_s2
        cruise_s = cruise_mm / top_mm_s
        self._ramps = (entry_mm_s, top_mm_s, acceleration_time_s, cruise_s)
        self._start_s = now_s
        self._end_s = now_s + acceleration_time_s + cruise_s + (top_mm_s - exit_mm_s) / acceleration_mm_s2
