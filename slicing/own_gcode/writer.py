"""Writer of a print's body: absolute moves, E in mm of filament, and a timeline."""

from __future__ import annotations

from typing import Protocol

E_RESET_MM = 1000.0
"""Value of E beyond which it is reset, because the firmware computes in single precision."""
MAX_TIME_INTERVAL_S = 60.0
"""Maximum time between two time comments."""

Move = tuple[float, float, float, float, float]
"""x, y, z and the filament extruded, all in mm, and the speed in mm/s."""


class TimeEstimator(Protocol):
    """Simulation of the printer's moves, which measures their time."""

    def move(self, x: float, y: float, z: float, e: float, speed_mm_s: float) -> None:
        """Go to x, y, z at a speed; `e` counts all filament extruded so far. Lengths are in mm."""

    def wait(self, seconds: float) -> None:
        """Wait at the current position."""

    def measure_time_s(self, finish: bool = False) -> float:
        """Return the time in s of the moves that have ended; with `finish`, of all moves."""


class Writer:
    """Writer of lines and time comments; lines that are added after the last `commit` are never written."""

    def __init__(self, time_estimator: TimeEstimator) -> None:
        self.text = bytearray()
        self.layer_count = 0
        self._time_estimator = time_estimator
        self._pending_items: list[Move | bytes | float | None] = []
        self._extruded_mm = self._base_mm = 0.0
        self._last_words = ["", "", "", "", "0.00000"]  # F, X, Y, Z, E as last written
        self._last_comment_s = 0.0

    def add_move(self, move: Move) -> None:
        """Record a move."""
        self._pending_items.append(move)

    def add_line(self, line: bytes) -> None:
        """Record a line that is written as it is, without its newline."""
        self._pending_items.append(line)

    def add_dwell(self, seconds: float) -> None:
        """Record a pause."""
        self._pending_items.append(seconds)

    def begin_layer(self, z_mm: float | None = None) -> None:
        """Begin a layer: now, or with the first move to this height since the last `commit`."""
        indices = (
            i for i, item in enumerate(self._pending_items) if isinstance(item, tuple) and item[2] == z_mm
        )
        self._pending_items.insert(next(indices, len(self._pending_items)), None)

    def commit(self) -> None:
        """Write everything that was recorded since the last `commit`."""
        for item in self._pending_items:
            if isinstance(item, tuple):
                self._write_move(item)
            elif item is None:
                self._write_layer()
            elif isinstance(item, bytes):
                self.text += item + b"\n"
            else:
                self.text += b"G4 P%d\n" % round(1000 * item)
                self._time_estimator.wait(item)
        self._pending_items.clear()

    def finish(self) -> float:
        """Close the timeline, and return the time of the print in s."""
        self._pending_items.clear()
        seconds = self._time_estimator.measure_time_s(finish=True)
        self.text += b";TIME_ELAPSED:%.3f\n" % seconds
        return seconds

    def _write_layer(self) -> None:
        if self.layer_count:
            self._write_time(self._time_estimator.measure_time_s())
        self.text += b";LAYER:%d\n" % self.layer_count
        self.layer_count += 1

    def _write_time(self, seconds: float) -> None:
        self.text += b";TIME_ELAPSED:%.3f\n" % seconds
        self._last_comment_s = seconds

    def _write_move(self, move: Move) -> None:
        x, y, z, extruded_mm, speed_mm_s = move
        last_words = self._last_words
        self._extruded_mm += extruded_mm
        if self._extruded_mm - self._base_mm > E_RESET_MM:
            self.text += b"G92 E0\n"
            self._base_mm += float(last_words[4])
            last_words[4] = "0.00000"
        words = (
            f"{speed_mm_s * 60:.0f}",
            f"{x:.3f}",
            f"{y:.3f}",
            f"{z:.3f}",
            f"{self._extruded_mm - self._base_mm:.5f}",
        )
        changed_words = [
            letter + word
            for letter, word, last in zip("FXYZE", words, last_words, strict=True)
            if word != last
        ]
        if not changed_words or (len(changed_words) == 1 and words[0] != last_words[0]):
            return  # no coordinate changes
        self._last_words = list(words)
        self.text += f"{'G1' if extruded_mm else 'G0'} {' '.join(changed_words)}\n".encode()
        self._time_estimator.move(x, y, z, self._extruded_mm, speed_mm_s)
        if self._time_estimator.measure_time_s() - self._last_comment_s > MAX_TIME_INTERVAL_S:
            self._write_time(self._time_estimator.measure_time_s())
