"""Groups of modules that mutation testing changes, with their tests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Group:
    """Group of modules, their tests, and the number of mutants to try."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    mutants: int


GROUPS = {
    "link": Group(
        tuple(f"drivers/link/{name}.py" for name in ("link", "opening", "outbox", "recovery", "replies")),
        ("tests/drivers/link",),
        26,
    ),
    "session": Group(
        (
            *(
                f"drivers/session/{name}.py"
                for name in ("session", "commands", "heat", "stream", "print_abort", "park", "identification")
            ),
            "drivers/safety/heater_watch.py",
        ),
        ("tests/drivers/session", "tests/drivers/safety/test_heater_watch.py"),
        22,
    ),
    "books": Group(
        tuple(
            f"farm/state/{name}.py"
            for name in (
                "books", "consequences", "outage", "plate_state", "printer_speed/time_factor",
                "reconciliation", "reels", "restore", "salvaged_parts", "transitions/jobs",
                "transitions/plates", "transitions/printers", "transitions/prints",
            )
        ),
        ("tests/farm/state", "tests/farm/control/test_part_commands.py"),
        28,
    ),
    "scheduling": Group(
        tuple(
            f"farm/scheduling/{name}.py"
            for name in (
                "admission", "assignment", "forecast", "holds", "hours", "matching", "plate_matching",
                "plate_queue", "situation", "start_rules",
            )
        ),
        ("tests/farm/scheduling",),
        26,
    ),
    "cost": Group(
        tuple(f"decompose/print_time/{name}.py" for name in ("cost", "pose_prices", "time_settings")),
        ("tests/decompose/print_time/test_cost.py",),
        14,
    ),
}  # fmt: skip
