"""Printers of the fleet as a decomposition sees them: rooms, speeds and the cost of a part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from farm.config import PrinterSection
from farm.model import JobOptions
from farm.planning.parts.part_rooms import model_sizes, printer_room
from farm.planning.parts.print_recipe import printer_cost, time_ratio
from farm.planning.printer_settings import printer_settings
from slicing.settings import FARM_QUALITIES, Resources


def price_rooms(
    printers: Sequence[PrinterSection],
    time_factors: Mapping[str, float],
    quality: str,
    resources: Resources,
    rounds: int = 1,
) -> tuple[list[PrinterRoom], CostModel]:
    """Return the part room and speed of each printer, the quickest first, and the cost of a part.

    Parameters
    ----------
    printers
        Parts are priced with the settings of the first.
    time_factors
        Learned of the printers, by name; 1 where none is.
    rounds
        How often each printer is listed.
    """
    settings = {section.name: printer_settings(section, quality, resources) for section in printers}
    costs = [printer_cost(section, settings[section.name]) for section in printers]
    times = {
        section.name: time_factors.get(section.name, 1.0) * time_ratio(own, costs[0])
        for section, own in zip(printers, costs, strict=True)
    }
    # A coarser nozzle is quicker, but nobody wished for one: it does not put its printer first.
    quickest = sorted(printers, key=lambda section: time_factors.get(section.name, 1.0))
    rooms = [
        PrinterRoom(section.name, model_sizes(room, settings[section.name]), times[section.name])
        for _ in range(rounds)
        for section in quickest
        for room in (printer_room(section, settings[section.name].brim_width_mm),)
    ]
    return rooms, costs[0]


def decomposition_options(options: JobOptions) -> Options:
    """Return the options with which a job's model is decomposed."""
    quality = FARM_QUALITIES.get(options.quality)
    fits = quality is not None and quality.fits_first_layer
    return Options(Engine(options.engine), fit_first_layer=fits, prove=False)  # a person waits: no proof
