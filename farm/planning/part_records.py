"""Records of one part at the stages of planning: decomposed, to be sliced, sliced."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.printers import PROFILES, UsableVolume
from farm.config import PrinterSection
from farm.model import (
    DEFAULT_PRINT_OPTIONS,
    NOMINAL_TIME_FACTORS,
    FeatureSeconds,
    PartGeometry,
    PartPrintOptions,
    TimeFactors,
)
from farm.planning.plate_times import compute_plate_seconds
from slicing.settings import EngineSettings, Resources, SettingsRequest

if TYPE_CHECKING:  # the daemon uses results of workers without importing their modules
    from decompose.results import Part as DecompositionPart
    from slicing.plate import PlateResult


@dataclass(frozen=True, slots=True)
class DecomposedPart:
    """Part as a file, before it is sliced.

    Attributes
    ----------
    stl
        STL file of the part in its printing pose.
    price_s
        Printing time of the part, as estimated by the cost model of the decomposition.
    printer
        Name of the printer for which the part was cut.
    glue_rank
        Position in the order in which parts are glued, from 1; None if the part has none.
    """

    id: str
    stl: Path
    geometry: PartGeometry
    price_s: float
    printer: str
    print_options: PartPrintOptions = DEFAULT_PRINT_OPTIONS
    glue_rank: int | None = None

    @staticmethod
    def from_part(part: DecompositionPart, folder: Path, glue_rank: int | None = None) -> DecomposedPart:
        """Make the record of a part from a decomposition whose files are in a folder."""
        low, high = part.solid.bounds_mm
        return DecomposedPart(
            id=part.id,
            stl=folder / part.file,
            geometry=PartGeometry(
                to_model=tuple(map(float, part.to_model.ravel())),
                min_mm=(float(low[0]), float(low[1]), float(low[2])),
                max_mm=(float(high[0]), float(high[1]), float(high[2])),
                volume_mm3=part.solid.volume_mm3,
            ),
            price_s=part.price_s,
            printer=part.printer,
            print_options=PartPrintOptions(
                brim_width_mm=part.brim_width_mm,
                layer_0_expansion_mm=part.layer_0_expansion_mm,
                bed_face_hidden=part.bed_face_hidden,
                tops_hidden=part.tops_hidden,
                flat_tops_visible=part.flat_tops_visible,
                hidden_sides=tuple((float(x), float(y), float(d)) for x, y, d in part.hidden_sides),
                hidden_grooves=tuple(
                    (int(side), float(low), float(high), float(depth))
                    for side, low, high, depth in part.hidden_grooves
                ),
                hidden_recesses=tuple(
                    (float(x0), float(y0), float(x1), float(y1), float(face), float(bottom))
                    for x0, y0, x1, y1, face, bottom in part.hidden_recesses
                ),
                stands=part.stands,
            ),
            glue_rank=glue_rank,
        )


@dataclass(frozen=True, slots=True)
class SliceTask:
    """Task to slice one part, which is printed alone.

    Attributes
    ----------
    part_name
        Name of the part, for messages.
    stl
        STL file of the part in its printing pose.
    settings
        Settings of the quality, with whose brim `usable_volumes` were computed. The brim, the first layer and
        the layer height of the part may differ from these settings.
    usable_volumes
        Boxes above the bed that the part may fill.
    out
        The G-code file to write.
    cache
        Folder of earlier slices; None for no cache.
    """

    part_name: str
    stl: Path
    request: SettingsRequest
    resources: Resources
    settings: EngineSettings
    usable_volumes: tuple[UsableVolume, ...]
    engine: Path
    out: Path
    cache: Path | None
    print_options: PartPrintOptions = DEFAULT_PRINT_OPTIONS


@dataclass(frozen=True, slots=True)
class SliceBatch:
    """Parts that are sliced concurrently, each for its own printer.

    Attributes
    ----------
    printers
        The printers of the parts, and possibly others.
    folder
        Folder for the G-code.
    cache
        Folder of earlier slices; None for no cache.
    """

    parts: tuple[DecomposedPart, ...]
    printers: tuple[PrinterSection, ...]
    quality: str
    folder: Path
    cache: Path | None

    def find_printer(self, part: DecomposedPart) -> PrinterSection:
        """Return the printer that a part was cut for."""
        return next(section for section in self.printers if section.name == part.printer)


@dataclass(frozen=True, slots=True)
class SlicedPart:
    """Part with its printer, its slice task and the result."""

    part: DecomposedPart
    printer: PrinterSection
    task: SliceTask
    result: PlateResult

    @property
    def features(self) -> FeatureSeconds:
        """Printing time of each feature of its layers (walls, infill, ...), according to the slice."""
        return FeatureSeconds(**asdict(self.result.features))

    def compute_expected_s(self, time_factors: TimeFactors = NOMINAL_TIME_FACTORS) -> float:
        """Return the expected time of its print in seconds; see `compute_plate_seconds`."""
        settings = self.task.settings
        return compute_plate_seconds(
            PROFILES[self.printer.model],
            self.result.sliced_s,
            settings.nozzle_c,
            settings.bed_c,
            time_factors.compute_factor(self.features.shares),
        )
