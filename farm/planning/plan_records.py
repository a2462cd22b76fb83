"""One part on its way into the books: what is sliced for it, and what is booked of it and of its slice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.printers import PROFILES, RoomBox
from farm.config import PrinterSection
from farm.model import Part, Plate
from farm.planning.error_translation import in_farm_words
from farm.planning.parts.part_rooms import printer_room
from farm.planning.plate_times import plate_seconds
from farm.planning.slicing_printers import slicing_printer
from farm.state.storage.file_store import store_file
from slicing.settings import EngineSettings, Resources, SettingsRequest, find_engine, resolve_settings

if TYPE_CHECKING:  # the daemon books what workers have cut and sliced, and loads nothing for either
    from decompose.results import Part as DecompositionPart
    from slicing.plate import PlateResult

MOST_WARNINGS = 3
"""Of a plate: walls too thin to print, the largest first."""
MAY_FALL = "stands on too little in every pose that fits: watch it while it prints, or give it a wider brim"


@dataclass(frozen=True, slots=True)
class Names:
    """What a part and its plate are called in the books."""

    job: int
    part: str
    plate: str


@dataclass(frozen=True, slots=True)
class DecomposedPart:
    """A part as a file, and what is known of it before it is sliced."""

    id: str
    stl: Path
    to_model: tuple[float, ...]
    min_mm: tuple[float, float, float]
    max_mm: tuple[float, float, float]
    volume_mm3: float
    estimated_s: float
    printer: str
    brim_width_mm: float | None = None  # None: the quality's
    layer_0_expansion_mm: float | None = None  # None: the quality's
    stands: bool = True  # while it is printed, in the pose that it is printed in

    @staticmethod
    def of(part: DecompositionPart, folder: Path) -> DecomposedPart:
        """A part as it was written into a folder."""
        lo, hi = part.solid.bounds_mm
        return DecomposedPart(
            id=part.id,
            stl=folder / part.file,
            to_model=tuple(map(float, part.to_model.ravel())),
            min_mm=(float(lo[0]), float(lo[1]), float(lo[2])),
            max_mm=(float(hi[0]), float(hi[1]), float(hi[2])),
            volume_mm3=part.solid.volume_mm3,
            estimated_s=part.price_s,
            printer=part.printer,
            brim_width_mm=part.brim_width_mm,
            layer_0_expansion_mm=part.layer_0_expansion_mm,
            stands=part.stands,
        )


@dataclass(frozen=True, slots=True)
class SliceTask:
    """One part, to be printed alone.

    `settings` are the quality's, for which the room was computed; the part is sliced with its own: another
    brim, first layer or layer height.
    """

    part: str
    stl: Path  # in printing pose
    request: SettingsRequest
    resources: Resources
    settings: EngineSettings
    room: tuple[RoomBox, ...]
    engine: Path
    out: Path
    cache: Path | None
    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None


def settings_request(section: PrinterSection, quality: str) -> SettingsRequest:
    """What the slicer is asked for on a printer of the fleet: parts lie in poses that count on supports."""
    return SettingsRequest(
        slicing_printer(PROFILES[section.model]),
        quality,
        section.material,
        nozzle_mm=section.nozzle_mm,
        supported=True,
    )


def printer_settings(section: PrinterSection, quality: str, resources: Resources) -> EngineSettings:
    """The slicer's settings for a printer of the fleet. Raises FarmError with code `settings`."""
    with in_farm_words():
        return resolve_settings(settings_request(section, quality), resources)


def slice_task(
    part: DecomposedPart,
    section: PrinterSection,
    quality: str,
    resources: Resources,
    folder: Path,
    cache: Path | None,
) -> SliceTask:
    """What is to be sliced of a part for this printer.

    Raises
    ------
    FarmError
        `engine` where there is no CuraEngine, `settings` where they cannot be resolved.
    """
    with in_farm_words():
        engine = find_engine()
    settings = printer_settings(section, quality, resources)
    return SliceTask(
        part=part.id,
        stl=part.stl,
        request=settings_request(section, quality),
        resources=resources,
        settings=settings,
        room=printer_room(section, settings.brim_width_mm),
        engine=engine,
        out=folder / f"{part.id}.gcode",
        cache=cache,
        brim_width_mm=part.brim_width_mm,
        layer_0_expansion_mm=part.layer_0_expansion_mm,
    )


def booked_part(names: Names, part: DecomposedPart, files: Path, cut_from: str | None = None) -> Part:
    """What the books keep of a part; its file goes into the store."""
    return Part(
        id=names.part,
        job=names.job,
        plate=names.plate,
        file=store_file(files, part.stl),
        to_model=part.to_model,
        min_mm=part.min_mm,
        max_mm=part.max_mm,
        volume_mm3=part.volume_mm3,
        brim_width_mm=part.brim_width_mm,
        layer_0_expansion_mm=part.layer_0_expansion_mm,
        stands=part.stands,
        cut_from=cut_from,
    )


def booked_plate(
    names: Names,
    section: PrinterSection,
    settings: EngineSettings,
    sliced: PlateResult,
    factor: float,
    files: Path,
    stands: bool = True,
) -> Plate:
    """What the books keep of a slice; its file goes into the store.

    Parameters
    ----------
    settings
        That it was sliced with.
    factor
        What was learned of the printer.
    stands
        Whether the part does, while it is printed.
    """
    profile = PROFILES[section.model]
    falls = () if stands else (MAY_FALL,)
    return Plate(
        id=names.plate,
        job=names.job,
        parts=(names.part,),
        gcode=store_file(files, sliced.gcode),
        sha256=sliced.sha256,
        print_time_s=sliced.print_time_s,
        estimated_s=plate_seconds(profile, sliced.print_time_s, settings.nozzle_c, settings.bed_c, factor),
        grams=sliced.grams,
        filament_mm=sliced.filament_mm,
        price=section.price(sliced.grams),
        layers=sliced.layers,
        min_mm=sliced.min_mm,
        max_mm=sliced.max_mm,
        material=section.material,
        nozzle_mm=section.nozzle_mm,
        kin=profile.kin,
        printer=section.name,
        time_factor=factor,
        cached=sliced.cached,
        warnings=(*falls, *map(str, sliced.unprinted[:MOST_WARNINGS])),
    )
