"""A job's model cut for its printers: what a worker does first of a plan, and all that it loads for it."""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.export import write_decomposition
from decompose.geometry import Model, Solid
from decompose.options import BestOptions, Engine, Options
from decompose.print_time import CostModel, Recipe
from decompose.printers import PrinterRoom
from decompose.relevel import relevel_planes
from decompose.results import Decomposition
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions
from farm.planning.error_translation import in_farm_words
from farm.planning.inspect_model import read_inspected
from farm.planning.parts.part_rooms import model_sizes, printer_room
from farm.planning.parts.print_recipe import printer_cost, slower
from farm.planning.parts.printer_choice import Cut
from farm.planning.plan import Decomposed, DecomposeTask, Sliced, TooFewPrinters
from farm.planning.plan_records import DecomposedPart, printer_settings
from farm.planning.plate_times import quickest_first
from slicing.settings import FARM_QUALITIES, Resources, find_resources


def warm() -> None:
    """Import and compile what planning needs, before somebody waits for it: cut a small box in two."""
    box = Model(Solid.box((0.0, 0.0, 0.0), (30.0, 10.0, 10.0)), (), 1.0)
    rooms = [PrinterRoom(name, ((20.0, 20.0, 20.0),)) for name in "ab"]
    decompose_model(box, rooms, Options(prove=False), CostModel.from_recipe(Recipe()))


def decompose_job(task: DecomposeTask) -> Decomposed:
    """Cut a job's model for its printers; runs in a worker.

    Raises
    ------
    TooFewPrinters
        With the number that would do.
    FarmError
        `no_fit`, `geometry`, `settings` or `model`, with the reason.
    """
    with in_farm_words():
        resources = find_resources()
    rooms, cost = priced_rooms(task.printers, task.factors, task.options.quality, resources, task.rounds)
    model = read_inspected(task.model)
    options = decomposition_options(task.options)
    if task.budget_s is not None:
        options = replace(options, best=BestOptions(task.budget_s))
    try:
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:  # they end with the worker
            cut = Cut(model, rooms, options, cost, threads)
            if task.within_s is not None:
                found = cut.in_time(task.within_s)
            elif task.options.printers is None:
                found = cut.whole() or cut.worth_it()
            else:
                found = cut.for_all()
        written = write_decomposition(found, task.folder)
    except NoFit as error:
        if error.printers_needed is not None and error.printers_needed > len(rooms):
            raise TooFewPrinters(str(error), error.printers_needed) from error
        raise FarmError(str(error), ErrorCode.NO_FIT) from error
    except Exception:
        with in_farm_words():
            raise
    cut_up = _decomposed(written, model, task.folder)
    return replace(cut_up, parts=_for_the_quickest(cut_up.parts, task))


def _decomposed(written: Decomposition, model: Model, folder: Path) -> Decomposed:
    return Decomposed(
        parts=tuple(DecomposedPart.of(part, folder) for part in written.parts),
        serial_s=written.serial_s,
        repairs=model.repairs,
        scale=model.scale,
        cutting=None if written.cutting is None else pickle.dumps(written.without_parts()),
    )


def level_again(sliced: Sliced, folder: Path) -> Decomposed | None:
    """The same parts, their cuts moved so that the one that is slowest as it is sliced ends sooner.

    Written to `folder`; None where nothing is to be gained. Runs in a worker.

    Raises
    ------
    FarmError
        `geometry`, `no_fit` or `settings`, with the reason.
    """
    task = sliced.task
    assert sliced.decomposed.cutting is not None  # else it is not worth levelling
    was: Decomposition = pickle.loads(sliced.decomposed.cutting)  # our own worker's
    with in_farm_words():
        resources = find_resources()
    costs = {
        section.name: printer_cost(section, printer_settings(section, task.options.quality, resources))
        for section in task.printers
    }
    cost = costs[task.printers[0].name]  # that parts are priced with, as in `priced_rooms`
    took_s = [
        seconds / slower(costs[section.name], than=cost)
        for section, seconds in zip(sliced.sections(), sliced.took_s(), strict=True)
    ]
    model = read_inspected(task.model)
    with in_farm_words(), ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
        found = relevel_planes(model, was, took_s, cost, threads)
        return None if found is None else _decomposed(write_decomposition(found, folder), model, folder)


def priced_rooms(
    printers: Sequence[PrinterSection],
    factors: Mapping[str, float],
    quality: str,
    resources: Resources,
    rounds: int = 1,
) -> tuple[list[PrinterRoom], CostModel]:
    """The printers as a decomposition sees them, the quickest first, and what a part costs on them."""
    settings = {section.name: printer_settings(section, quality, resources) for section in printers}
    # Poses and cuts are priced with the settings of the first.
    costs = [printer_cost(section, settings[section.name]) for section in printers]
    times = {
        section.name: factors.get(section.name, 1.0) * slower(own, than=costs[0])
        for section, own in zip(printers, costs, strict=True)
    }
    # Nobody asked for a coarser nozzle: that it is quicker does not put its printer first.
    quickest = sorted(printers, key=lambda section: factors.get(section.name, 1.0))
    rooms = [
        PrinterRoom(section.name, model_sizes(room, settings[section.name]), times[section.name])
        for _ in range(rounds)
        for section in quickest
        for room in (printer_room(section, settings[section.name].brim_width_mm),)
    ]
    return rooms, costs[0]


def decomposition_options(options: JobOptions) -> Options:
    """How a job's model is cut."""
    quality = FARM_QUALITIES.get(options.quality)
    fits = quality is not None and quality.fits_first_layer
    return Options(Engine(options.engine), fit_first_layer=fits, prove=False)  # a person waits: no proof


def _for_the_quickest(parts: Sequence[DecomposedPart], task: DecomposeTask) -> tuple[DecomposedPart, ...]:
    """The parts, the longest work on the quickest of the printers that are otherwise equal."""
    loads_s: dict[str, float] = {}
    for part in parts:
        loads_s[part.printer] = loads_s.get(part.printer, 0.0) + part.estimated_s
    kinds = {s.name: (s.model, s.material, s.nozzle_mm, s.volume_mm) for s in task.printers}
    takes = quickest_first(loads_s, kinds, task.factors)
    return tuple(replace(part, printer=takes[part.printer]) for part in parts)
