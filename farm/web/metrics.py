"""Metrics of the farm for Prometheus, collected at each scrape. Only this module imports prometheus_client.

Totals are computed from the books, not counted in memory, so that they never decrease, even at a restart.
No label is the name of a job, a person or a file, which keeps the number of time series small.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from farm import api
from farm.model import Bed, JobState, Link, PrintState
from farm.state import Books, PlateState
from farm.views import ViewContext, compute_duration_s

CONTENT_TYPE = CONTENT_TYPE_LATEST
_PRINTER_STATES = (
    *("idle", "look", "maintenance", "disabled", "unknown"),  # look: a person must inspect the printer
    *(str(state) for state in PrintState if not state.ended),
    *(str(link) for link in Link if link is not Link.READY),
)
"""Values of `PrinterView.state`; each printer has a sample for each of them, so that alerts can use them."""
Rows = Iterable[tuple[tuple[str, ...], float | None]]
"""Pairs of a sample's label values and its value; None stands for no sample."""


def format_metrics(context: ViewContext, status: api.Status) -> bytes:
    """Format all metrics in the text format of Prometheus.

    Parameters
    ----------
    context
        State of the farm, with the books.
    status
        Status of the farm at the same time, as `farm status` shows it.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_FarmCollector(context, status))
    return generate_latest(registry)


class _FarmCollector(Collector):
    """Collector of all metrics of the farm."""

    def __init__(self, context: ViewContext, status: api.Status) -> None:
        self._context, self._status = context, status

    def collect(self) -> Iterator[Metric]:
        yield InfoMetricFamily("farm_build", "Version of farm.", {"version": self._status.daemon.version})
        yield _make_gauge(
            "farm_clock_scale",
            "Speed of the farm's clock; 1 is real time.",
            (),
            [((), self._status.fleet.time_scale)],
        )
        yield from _collect_jobs(self._context)
        yield from _collect_printers(self._status)
        yield from _collect_prints(self._context.books)


def _collect_jobs(context: ViewContext) -> Iterator[Metric]:
    books = context.books
    states = Counter(str(job.state) for job in books.jobs.values())
    yield _make_gauge(
        "farm_jobs",
        "Jobs by state.",
        ("state",),
        (((str(state),), states[str(state)]) for state in JobState),
    )
    waiting_plates = (
        plate for plate in books.list_waiting_plates() if books.find_plate_state(plate) is PlateState.WAITING
    )
    holds = Counter(
        "none" if hold is None else str(hold.code) for hold in map(context.find_plate_hold, waiting_plates)
    )
    yield _make_gauge(
        "farm_plates_waiting",
        "Waiting plates by hold code; `none` for plates that are about to start.",
        ("code",),
        (((code,), count) for code, count in holds.items()),
    )


def _collect_printers(status: api.Status) -> Iterator[Metric]:
    printers = status.printers
    tasks = Counter(task.code for task in status.todo)
    yield _make_gauge(
        "farm_todo", "Tasks for people.", ("code",), (((code,), count) for code, count in tasks.items())
    )
    info = GaugeMetricFamily("farm_printer_info", "Printers.", labels=("printer", "model", "material"))
    for printer in printers:
        info.add_metric((printer.name, printer.model, printer.reel.material), 1)
    yield info
    yield _make_gauge(
        "farm_printer_state",
        "1 for the current state of a printer, 0 for all other states.",
        ("printer", "state"),
        (
            ((printer.name, state), printer.state == state)
            for printer in printers
            for state in _PRINTER_STATES
        ),
    )
    yield _make_printer_gauge(
        "farm_printer_bed_clear",
        "1 if the bed is clear.",
        printers,
        lambda printer: printer.bed is Bed.CLEAR,
    )
    yield _make_printer_gauge(
        "farm_printer_heaters_off",
        "1 if the board reports that the heaters are off.",
        printers,
        lambda printer: printer.heaters_off,
    )
    yield _make_printer_gauge(
        "farm_agent_up", "1 if the agent runs.", printers, lambda printer: printer.agent_pid is not None
    )
    yield from _collect_readings(printers)


def _collect_readings(printers: Sequence[api.PrinterView]) -> Iterator[Metric]:
    """Collect the values that printers report; a printer without a value has no sample."""
    heaters = ("printer", "heater")
    yield _make_gauge(
        "farm_printer_temperature_celsius",
        "Temperature of a heater.",
        heaters,
        (
            ((printer.name, heater), now_c)
            for printer in printers
            for heater, now_c in (("nozzle", printer.nozzle_c), ("bed", printer.bed_c))
        ),
    )
    yield _make_gauge(
        "farm_printer_target_celsius",
        "Target of a heater; 0 is off.",
        heaters,
        (
            ((printer.name, heater), target_c)
            for printer in printers
            for heater, target_c in (("nozzle", printer.targets.nozzle_c), ("bed", printer.targets.bed_c))
        ),
    )
    yield _make_printer_gauge(
        "farm_print_progress_ratio",
        "Progress of the unfinished print, by time.",
        printers,
        lambda printer: printer.print.progress if printer.print else None,
    )
    yield _make_printer_gauge(
        "farm_print_remaining_seconds",
        "Expected time to the end of the unfinished print.",
        printers,
        lambda printer: printer.print.remaining_s if printer.print else None,
    )
    yield _make_printer_gauge(
        "farm_reel_remaining_grams", "Filament left.", printers, lambda printer: printer.reel.grams
    )
    yield _make_printer_gauge(
        "farm_printer_time_factor",
        "Ratio of the actual printing time of a printer's layers to the slicer's estimate.",
        printers,
        lambda printer: printer.time_factor,
    )


def _collect_prints(books: Books) -> Iterator[Metric]:
    counts: Counter[tuple[str, str]] = Counter()
    seconds: dict[tuple[str, str], float] = {}
    grams: dict[tuple[str, str], float] = {}
    for attempt in books.prints.values():
        if attempt.state.ended:
            key = attempt.printer, str(attempt.state)
            counts[key] += 1
            seconds[key] = seconds.get(key, 0.0) + compute_duration_s(attempt)
            grams[key] = grams.get(key, 0.0) + attempt.grams
    labels = ("printer", "outcome")
    families: tuple[tuple[str, str, Mapping[tuple[str, str], float]], ...] = (
        ("farm_prints", "Prints that have ended.", counts),
        ("farm_print_seconds", "Time of prints that have ended.", seconds),
        ("farm_filament_grams", "Filament of prints that have ended.", grams),
    )
    for name, text, values in families:
        family = CounterMetricFamily(name, text, labels=labels)
        for key in sorted(values):
            family.add_metric(key, values[key])
        yield family


def _make_printer_gauge(
    name: str,
    text: str,
    printers: Sequence[api.PrinterView],
    find_value: Callable[[api.PrinterView], float | None],
) -> Metric:
    """Return a gauge with one sample for each printer that has a value."""
    return _make_gauge(
        name, text, ("printer",), (((printer.name,), find_value(printer)) for printer in printers)
    )


def _make_gauge(name: str, text: str, labels: Sequence[str], rows: Rows) -> Metric:
    """Return a gauge with the samples that have a value."""
    family = GaugeMetricFamily(name, text, labels=labels)
    for values, value in rows:
        if value is not None:
            family.add_metric(values, float(value))
    return family
