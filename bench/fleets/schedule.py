"""Time of one scheduling decision, and the forecast of a night compared with its lower bound.

Usage: python -m bench.fleets.schedule [--printers N] [--plates N] [--json]

Half the printers of the fleet print, and a queue has plates of random times, some of which fit the tall
printers only. `assign_ms` and `forecast_ms` are the best of three. `over_bound` is the share by which the
forecast of one job exceeds its lower bound, with a person always present (the bound ignores clearing beds).
"""

from __future__ import annotations

import argparse
import json
import random
import time
from collections.abc import Callable
from dataclasses import replace
from zoneinfo import ZoneInfo

from farm.model import Bed, FilamentState, Link
from farm.scheduling import (
    Capabilities,
    FleetPrinter,
    Hours,
    PlateQueue,
    Requirements,
    Situation,
    StartRules,
    WaitingPlate,
    assign_plates,
    forecast_prints,
)
from farm.week_windows import parse_window

NOW_S = 1_790_000_000.0
SHORT_PRINTER = Capabilities(((-111.0, -104.0, 111.0, 102.0, 205.0),), "generic_pla", None, 0.4)
TALL_PRINTER = Capabilities(((-111.0, -104.0, 111.0, 102.0, 305.0),), "generic_pla", None, 0.4)


def make_fleet(count: int, busy: bool) -> list[FleetPrinter]:
    """Make a fleet with every third printer tall; if `busy`, every second printer prints for some hours."""
    return [
        FleetPrinter(
            name=f"um2-{number:03d}",
            capabilities=TALL_PRINTER if number % 3 == 0 else SHORT_PRINTER,
            bed=Bed.CLEAR,
            filament=FilamentState.PARKED,
            link=Link.READY,
            is_booked=busy and number % 2 == 0,
            attention_reason=None,
            print_end_s=NOW_S + 3600.0 * (number % 7) if busy and number % 2 == 0 else None,
            grams=500.0 if number % 5 else None,
        )
        for number in range(count)
    ]


def make_queue(count: int, rng: random.Random) -> list[WaitingPlate]:
    """Make the plates of ten jobs."""
    plates = []
    for number in range(count):
        height_mm = 250.0 if rng.random() < 0.2 else 100.0
        plates.append(
            WaitingPlate(
                id=f"{number % 10}/{number:04d}",
                requirements=Requirements("generic_pla", None, 0.4, (-50.0, -50.0, 50.0, 50.0, height_mm)),
                job=number % 10,
                planned_printer=f"um2-{rng.randrange(100):03d}",
                expected_s=rng.uniform(1800.0, 36000.0),
                overhead_s=300.0,
                first_layer_s=600.0,
                grams=rng.uniform(5.0, 150.0),
            )
        )
    return plates


def measure_best_ms(function: Callable[[], object]) -> float:
    """Call a function three times; return the shortest time in ms."""
    times_s = []
    for _ in range(3):
        start_s = time.perf_counter()
        function()
        times_s.append(time.perf_counter() - start_s)
    return min(times_s) * 1000


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=100)
    parser.add_argument("--plates", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    zone = ZoneInfo("Europe/London")
    hours = Hours((parse_window("mon-fri 08:00-18:00"),), zone)
    attended_rules = StartRules(hours, Hours((), zone), first_layers_attended=False, max_heating=20)
    unrestricted_rules = StartRules(Hours((), zone), Hours((), zone))
    plates = make_queue(options.plates, random.Random(1))
    busy_fleet, idle_fleet = make_fleet(options.printers, busy=True), make_fleet(options.printers, busy=False)
    unlimited_fleet = [replace(printer, grams=None) for printer in idle_fleet]
    forecast = forecast_prints(
        Situation(
            PlateQueue.from_plates(replace(plate, job=1) for plate in plates),
            tuple(unlimited_fleet),
            unrestricted_rules,
            NOW_S,
        )
    )
    report = {
        "schema": 1,
        "printers": options.printers,
        "plates": options.plates,
        "assign_ms": measure_best_ms(
            lambda: assign_plates(
                Situation(PlateQueue.from_plates(plates), tuple(busy_fleet), attended_rules, NOW_S)
            )
        ),
        "forecast_ms": measure_best_ms(
            lambda: forecast_prints(
                Situation(PlateQueue.from_plates(plates), tuple(unlimited_fleet), unrestricted_rules, NOW_S)
            )
        ),
        "over_bound": (forecast.end_s - NOW_S) / (forecast.lower_bound_s - NOW_S) - 1,
    }
    if options.json:
        print(json.dumps(report))
        return
    print(
        f"{options.plates} plates, {options.printers} printers: assigned in {report['assign_ms']:.0f} ms, ",
        end="",
    )
    print(f"forecast in {report['forecast_ms']:.0f} ms, {report['over_bound']:.1%} above the lower bound")


if __name__ == "__main__":
    main()
