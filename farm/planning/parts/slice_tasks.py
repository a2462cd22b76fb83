"""Slice tasks of decomposed parts, each for its own printer."""

from __future__ import annotations

from farm.planning.error_translation import translate_errors
from farm.planning.part_records import SliceBatch, SliceTask
from farm.planning.parts.part_rooms import printer_room
from farm.planning.printer_settings import printer_settings, settings_request
from slicing.settings import find_engine, find_resources


def build_slice_tasks(batch: SliceBatch) -> list[SliceTask]:
    """Build a slice task for each part of a batch.

    Raises
    ------
    FarmError
        `engine` where there is no CuraEngine, `settings` where the settings cannot be resolved.
    """
    with translate_errors():
        resources, engine = find_resources(), find_engine()
    tasks = []
    for part in batch.parts:
        section = batch.printer_of(part)
        settings = printer_settings(section, batch.quality, resources)
        tasks.append(
            SliceTask(
                part=part.id,
                stl=part.stl,
                request=settings_request(section, batch.quality),
                resources=resources,
                settings=settings,
                room=printer_room(section, settings.brim_width_mm),
                engine=engine,
                out=batch.folder / f"{part.id}.gcode",
                cache=batch.cache,
                print_options=part.print_options,
            )
        )
    return tasks
