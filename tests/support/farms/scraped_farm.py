"""Prometheus scrapes of a farm with ended prints."""

import itertools

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.http import Services, describe_farm
from farm.model import AgentPrint, AgentSnapshot, FilamentState, JobOptions, Link, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.web.metrics import format_metrics


class ScrapedFarm:
    """A farm whose printer `a` prints, while `b` has never reported."""

    def __init__(self, folder):
        self._folder = folder
        self._numbers = itertools.count(1)
        self.restart()

    def restart(self):
        """Start another daemon on the same database."""
        self._farm = Farm(self._folder)
        self._farm.controller.started_s -= 3600.0
        self._farm.report_ready(
            "a", nozzle_c=25.0, bed_c=24.0, nozzle_target_c=0.0, bed_target_c=0.0, heaters_off=True
        )

    def print_plate(self, state):
        """Print the plate of a new job, and report the print in a given state."""
        farm, number = self._farm, next(self._numbers)
        farm.clear_bed("a")
        farm.jobs.submit(f"request-{number}", "m.stl", INSPECTED_MODEL, JobOptions())
        event = make_plan_event(number, 1)
        plates = tuple(plate.model_copy(update={"printer": "a"}) for plate in event.plates)
        farm.controller.on_plan(number, Plan(event.parts, plates, event.repairs, 1.0, 500.0))
        attempt = farm.controller.books.find_open_print("a")
        now_s = farm.controller.clock.now()
        for print_state in (PrintState.PRINTING, state):
            farm.controller.on_snapshot(
                AgentSnapshot(
                    printer="a",
                    link=Link.READY if print_state.ended else Link.BUSY,
                    agent_pid=9,
                    nozzle_c=210.0,
                    filament=FilamentState.PARKED,
                    print=AgentPrint(
                        print_id=attempt.id,
                        state=print_state,
                        fault="thermal_runaway" if print_state is PrintState.FAILED else None,
                        reason=None,
                        progress_s=5.0,
                        print_time_s=90.0,
                        extruded=True,
                        started_s=now_s - 100.0,
                        ended_s=now_s if print_state.ended else None,
                    ),
                )
            )

    def lose_host(self, printer):
        """Report that the connection to a printer's host is lost."""
        snapshot = AgentSnapshot(
            printer=printer, link=Link.STARTING, reason="no route to host", host_lost=True
        )
        self._farm.controller.on_snapshot(snapshot)

    def scrape(self):
        """Return the text that Prometheus gets in a scrape."""
        controller, state = self._farm.controller, StateFolder(self._folder)
        services = Services(controller, state, self._folder / "fleet.yaml", None, None)
        return format_metrics(controller.build_view_context(state), describe_farm(services)).decode()
