"""Heaters with thermal inertia, computed without time steps."""

from __future__ import annotations

import math

from drivers.printers import HeaterModel

AMBIENT_C = 21.0
FULL_POWER = 127  # value that M105 reports after @: and B@: at full power


class Heater:
    """First-order heater under its firmware's control.

    Parameters
    ----------
    model
        Gain and time constant.
    period_s
        0 for an ideal controller (the nozzle's PID): full power up to the target, then exactly the power that
        holds it. Above 0, the heater is switched on or off once per period (the bed: 5 s,
        docs/explanation/ultimaker2-serial.md, section 1.2).
    is_dead
        True if the heating element produces no heat; the sensor works.

    Attributes
    ----------
    is_mosfet_shorted
        True if the heater's MOSFET is shorted: full power at any target.
    """

    __slots__ = (
        "_is_on",
        "_next_decision_s",
        "_period_s",
        "_temperature_c",
        "_time_s",
        "is_dead",
        "is_mosfet_shorted",
        "model",
        "target_c",
    )

    def __init__(self, model: HeaterModel, period_s: float = 0.0, is_dead: bool = False) -> None:
        self.model = model
        self.is_dead = is_dead
        self.is_mosfet_shorted = False
        self.target_c = 0.0
        self._period_s = period_s
        self._temperature_c = AMBIENT_C
        self._time_s = 0.0
        self._next_decision_s = 0.0
        self._is_on = False

    def set_target(self, target_c: float, now_s: float) -> None:
        """Set the target; 0 is off."""
        self.compute_temperature_c(now_s)
        self.target_c = target_c

    def compute_temperature_c(self, now_s: float) -> float:
        """Compute the temperature at a time, which must not be before the time of the last call."""
        if now_s > self._time_s:
            if self.is_mosfet_shorted:
                self._update_temperature(now_s - self._time_s, is_powered=True)
                self._next_decision_s = now_s
            elif self._period_s > 0.0:
                self._switch(now_s)
            else:
                self._regulate(now_s)
            self._time_s = now_s
        return self._temperature_c

    def compute_power(self, now_s: float) -> int:
        """Compute the power, 0 to 127, as ``M105`` reports it."""
        temperature_c = self.compute_temperature_c(now_s)
        if self._period_s > 0.0:
            return FULL_POWER if self._is_on and self.target_c > 0.0 else 0
        if self.target_c <= AMBIENT_C or temperature_c > self.target_c:
            return 0
        if temperature_c < self.target_c:
            return FULL_POWER
        return round(FULL_POWER * (self.target_c - AMBIENT_C) / self.model.gain_c)

    def compute_heating_s(self, temperature_c: float, now_s: float) -> float:
        """Compute the seconds at full power to reach a temperature; infinite if it is unreachable."""
        if self.is_dead:
            return math.inf if self.compute_temperature_c(now_s) < temperature_c else 0.0
        return self.model.compute_heating_s(temperature_c, self.compute_temperature_c(now_s), AMBIENT_C)

    def compute_cooling_s(self, temperature_c: float, now_s: float) -> float:
        """Compute the seconds without power to cool to a temperature; infinite if it is unreachable."""
        start_c = self.compute_temperature_c(now_s)
        if start_c <= temperature_c:
            return 0.0
        if temperature_c <= AMBIENT_C:
            return math.inf
        return self.model.tau_s * math.log((start_c - AMBIENT_C) / (temperature_c - AMBIENT_C))

    def _update_temperature(self, duration_s: float, is_powered: bool) -> None:
        end_c = AMBIENT_C + (self.model.gain_c if is_powered and not self.is_dead else 0.0)
        decay = math.exp(-duration_s / self.model.tau_s)
        self._temperature_c = end_c + (self._temperature_c - end_c) * decay

    def _regulate(self, now_s: float) -> None:
        target_c = max(self.target_c, AMBIENT_C)
        if self.is_dead:
            self._update_temperature(now_s - self._time_s, is_powered=False)
            return
        is_below = self._temperature_c < target_c
        self._update_temperature(now_s - self._time_s, is_powered=is_below)
        if (self._temperature_c >= target_c) == is_below:
            self._temperature_c = target_c  # reached in between, and held since then

    def _switch(self, now_s: float) -> None:
        if self.target_c <= AMBIENT_C:
            self._is_on = False
            self._update_temperature(now_s - self._time_s, is_powered=False)
            self._next_decision_s = now_s
            return
        while self._time_s < now_s:
            if self._time_s >= self._next_decision_s:
                self._is_on = self._temperature_c < self.target_c
                self._next_decision_s = self._time_s + self._period_s
            step_end_s = min(now_s, self._next_decision_s)
            self._update_temperature(step_end_s - self._time_s, self._is_on)
            self._time_s = step_end_s
