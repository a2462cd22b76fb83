"""Heaters, head, filament and bed of a printer, which a reset of the firmware does not change."""

from __future__ import annotations

from dataclasses import replace

from drivers.emulator.faults import WEAK_BED_C, WEAK_NOZZLE_C, Faults
from drivers.emulator.hardware.thermal import AMBIENT_C, Heater
from drivers.printers import Profile

# [assumed] Reading of a shorted bed sensor: below MINTEMP, which the firmware does not check for the bed.
SHORTED_SENSOR_C = -14.0
BED_PERIOD_S = 5.0
MATERIAL_CHANGE_RANGE_MM = 5.0  # distance from the top within which a person changes material
MAX_OOZE_MM = 0.5


class EmulatedBoard:
    """Physical state of a printer, without the state of its firmware.

    The bed is no longer clear once more than `MAX_OOZE_MM` of filament has left the nozzle while the head was
    more than `MATERIAL_CHANGE_RANGE_MM` below its highest position. Filament leaves the nozzle only when its
    end is pushed past the tip. So pushing parked filament to the nozzle leaves the bed clear. The same holds
    for purging with the bed lowered completely, as when a person changes material. Only `clear_bed` clears
    the bed.

    Parameters
    ----------
    profile
        The printer model.
    faults
        Faults to inject.

    Attributes
    ----------
    head_position_mm
        True position of the head (x, y, z), which the firmware may not know.
    filament_mm
        Net filament through the feeder since power-on.
    filament_end_mm
        Position of the filament's tip relative to the nozzle's tip; never above 0.
    change_count
        Number of changes that a person at the printer would notice at once.
    """

    def __init__(self, profile: Profile, faults: Faults) -> None:
        self.profile = profile
        self.faults = faults
        nozzle, bed = profile.nozzle, profile.bed
        if faults.weak_nozzle:
            nozzle = replace(nozzle, gain_c=WEAK_NOZZLE_C - AMBIENT_C)
        if faults.weak_bed:
            bed = replace(bed, gain_c=WEAK_BED_C - AMBIENT_C)
        self.nozzle = Heater(nozzle, is_dead=faults.dead_nozzle)
        self.bed = Heater(bed, BED_PERIOD_S, is_dead=faults.dead_bed)
        self.is_bed_sensor_shorted = False  # the bed's sensor reads `SHORTED_SENSOR_C`
        self.head_position_mm = profile.home_mm
        self.filament_mm = 0.0
        self.filament_end_mm = -profile.park_retraction_mm  # as after the end code or the printer's own menu
        self.bed_clear = True
        self.change_count = 0
        self._bed_filament_mm = 0.0

    def feed_filament(self, e_mm: float, z_mm: float) -> None:
        """Feed filament by `e_mm` in a move that ends with the head at `z_mm`."""
        self.filament_mm += e_mm
        end_mm = self.filament_end_mm + e_mm
        if end_mm > 0.0:
            if self.bed_clear and z_mm < self.profile.top_mm - MATERIAL_CHANGE_RANGE_MM:
                self._bed_filament_mm += end_mm
                if self._bed_filament_mm > MAX_OOZE_MM:
                    self.bed_clear = False
                    self.change_count += 1
            end_mm = 0.0
        self.filament_end_mm = end_mm

    def clear_bed(self) -> None:
        """Clear the bed, as a person does."""
        self._bed_filament_mm = 0.0
        self.bed_clear = True
        self.change_count += 1

    def read_bed_c(self, now_s: float) -> float:
        """Return the reading of the bed's sensor."""
        return SHORTED_SENSOR_C if self.is_bed_sensor_shorted else self.bed.compute_temperature_c(now_s)

    def set_nozzle_target(self, target_c: float, now_s: float) -> None:
        """Set the nozzle's target; 0 is off."""
        self.nozzle.set_target(target_c, now_s)
        self.change_count += 1

    def set_bed_target(self, target_c: float, now_s: float) -> None:
        """Set the bed's target; 0 is off."""
        self.bed.set_target(target_c, now_s)
        if self.is_bed_sensor_shorted:
            # The controller reads a cold bed, and heats at full power.
            self.bed.is_mosfet_shorted = target_c > 0.0
        self.change_count += 1

    def switch_heaters_off(self, now_s: float) -> None:
        """Set both targets to 0."""
        self.set_nozzle_target(0.0, now_s)
        self.set_bed_target(0.0, now_s)
