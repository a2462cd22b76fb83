"""Parts of a job, the plates on which they are printed, and the time of each feature of the layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul
from typing import Any

from pydantic import model_validator

from farm.model.entity import Entity


class PartGeometry(Entity):
    """Size and pose of a part.

    Attributes
    ----------
    to_model
        Transform (4 x 4, row by row) from the part's file, in its printing pose, to the model's frame, in mm.
    min_mm, max_mm
        Corners of its box in the model's frame.
    """

    to_model: tuple[float, ...]
    min_mm: tuple[float, float, float]
    max_mm: tuple[float, float, float]
    volume_mm3: float


class PartPrintOptions(Entity):
    """Print settings that the decomposition chooses for one part, in its printing pose.

    Attributes
    ----------
    brim_width_mm, layer_0_expansion_mm
        Width of the brim, and horizontal expansion of the first layer; None: as the print quality sets it.
    bed_face_hidden, tops_hidden
        True if all faces on the bed, or all top faces, are cut faces that gluing hides.
    flat_tops_visible
        True if flat tops remain visible; their lines get the order that looks even.
    hidden_sides
        Outward normals nx, ny and offsets in mm of the upright sides that gluing hides.
    hidden_grooves
        Grooves for keys in these sides: index of the side, start and end of the groove along the side (in
        the direction (-ny, nx)), and its depth, in mm.
    hidden_recesses
        Boxes around the marks and grooves in horizontal faces that gluing hides: min_x, min_y, max_x, max_y,
        height of the face, and height of the bottom of the mark or groove, in mm.
    stands
        True if the part is expected to stay upright while it is printed.
    """

    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None
    bed_face_hidden: bool = False
    tops_hidden: bool = False
    flat_tops_visible: bool = True
    hidden_sides: tuple[tuple[float, float, float], ...] = ()
    hidden_grooves: tuple[tuple[int, float, float, float], ...] = ()
    hidden_recesses: tuple[tuple[float, float, float, float, float, float], ...] = ()
    stands: bool = True


DEFAULT_PRINT_OPTIONS = PartPrintOptions()


class Part(Entity):
    """Printable piece of a job."""

    id: str  # "3/p01"
    job: int
    plate: str
    file: str  # name in the file store: STL in printing pose, or G-code that a person submitted
    geometry: PartGeometry
    print_options: PartPrintOptions = DEFAULT_PRINT_OPTIONS
    cut_from: str | None = None  # id of the failed part from which it was cut
    copy_number: int = 1  # number of the copy of the model, from 1
    glue_rank: int | None = None  # place in the order in which parts are glued, from 1; None: unknown

    @model_validator(mode="before")
    @classmethod
    def _nest_flat_fields(cls, fields: Any) -> Any:
        """Move geometry and print options, which farm 0.1 stored as flat fields, into nested records."""
        if not isinstance(fields, dict) or "geometry" in fields:
            return fields
        nested_fields: dict[str, Any] = dict(fields)
        for name, record in (("geometry", PartGeometry), ("print_options", PartPrintOptions)):
            nested_fields[name] = {
                key: nested_fields.pop(key) for key in record.model_fields if key in nested_fields
            }
        return nested_fields


Shares = tuple[float, ...]
"""Shares of walls, infill, skins, supports and travel in the time of the layers; they sum to 1."""


class FeatureSeconds(Entity):
    """Time of each feature of a plate's layers, as sliced.

    Supports include the brim. Travel is all time without extrusion, including retractions.
    """

    walls_s: float
    infill_s: float
    skins_s: float
    supports_s: float
    travel_s: float

    @property
    def shares(self) -> Shares | None:
        """Share of each feature in the total time; None if the total is 0."""
        seconds = (self.walls_s, self.infill_s, self.skins_s, self.supports_s, self.travel_s)
        total_s = sum(seconds)
        return tuple([value_s / total_s for value_s in seconds]) if total_s > 0.0 else None


class FeatureFactors(Entity):
    """Ratios of actual to sliced time of each feature of the layers, learned from finished prints."""

    walls: float
    infill: float
    skins: float
    supports: float
    travel: float
    prints: int  # number of finished prints from which they were learned
    own: bool  # True if learned from this printer alone, not from its whole family

    @property
    def factors(self) -> tuple[float, ...]:
        """Factors in the order of `Shares`."""
        return self.walls, self.infill, self.skins, self.supports, self.travel


@dataclass(frozen=True, slots=True)
class TimeFactors:
    """Ratios of actual to sliced time of a printer's layers: overall, and by feature after enough prints."""

    overall_factor: float = 1.0
    feature_factors: tuple[float, ...] | None = None  # in the order of `Shares`

    def compute_factor(self, shares: Shares | None) -> float:
        """Compute the time factor of layers from the shares of their features.

        Without shares, or before the printer has feature factors, return the overall factor.
        """
        if self.feature_factors is None or shares is None:
            return self.overall_factor
        return float(sum(map(mul, shares, self.feature_factors)))


NOMINAL_TIME_FACTORS = TimeFactors()
"""Time factors of a printer before its first print."""


def name_plate(plate: str, parts: Sequence[str]) -> str:
    """Name a plate for people: by its part, such as `2/p01`, if it has only one; otherwise by its id."""
    return parts[0] if len(parts) == 1 else plate


class Plate(Entity):
    """Part and G-code that a printer prints in one go."""

    id: str  # "3/01"
    job: int
    parts: tuple[str, ...]
    gcode: str
    sha256: str
    sliced_s: float  # time of its layers, estimated by CuraEngine, or by the farm for own G-code
    features: FeatureSeconds | None = None  # `sliced_s` by feature; None: unknown, as for submitted G-code
    expected_s: float  # time with heat-up, start and end code, and with the printer's time factor
    grams: float
    filament_mm: float
    price: float | None = None  # price of its filament on the planned printer, in the fleet's currency
    layers: int
    min_mm: tuple[float, float, float]  # corners of the box of all extrusion, relative to the bed's centre
    max_mm: tuple[float, float, float]
    material: str
    nozzle_mm: float
    family: str | None = None  # `Profile.family`: the printer family that it was sliced for; None: any
    printer: str  # the printer that the plan chose
    time_factor: float = 1.0  # time factor of that printer at planning; included in `expected_s`
    cached: bool = False  # True if its G-code came from the slice cache
    warnings: tuple[str, ...] = ()  # sentences, such as on walls that are too thin to print
    prints: tuple[str, ...] = ()
    # index of the first print whose failure counts towards the limit on attempts; `farm reprint` sets it
    # to the number of prints so far
    counted_from: int = 0
    replaced_by: tuple[str, ...] = ()  # plates printed instead of this one
    cancelled: bool = False  # True if a person has cancelled it; it is printed only on request
    paused: bool = False  # True if a person has paused it and nobody has resumed it

    @model_validator(mode="before")
    @classmethod
    def _drop_hold(cls, fields: Any) -> Any:
        """Drop the hold that farm 0.1 stored in a plate; holds are now computed from the state."""
        return {k: v for k, v in fields.items() if k != "hold"} if isinstance(fields, dict) else fields

    @property
    def name(self) -> str:
        """Name for people; see `name_plate`."""
        return name_plate(self.id, self.parts)

    @property
    def overhead_s(self) -> float:
        """Expected time of everything except the layers: heat-up, start and end code, in seconds."""
        return self.expected_s - self.sliced_s * self.time_factor

    @property
    def feature_shares(self) -> Shares | None:
        """Shares of the features in the time of its layers; None if they are not known."""
        return None if self.features is None else self.features.shares

    @property
    def first_layer_s(self) -> float:
        """Expected time in seconds to the end of the first layer, which is printed at half speed."""
        return self.overhead_s + 2.0 * self.sliced_s * self.time_factor / max(1, self.layers)

    def compute_expected_s(self, time_factors: TimeFactors) -> float:
        """Compute the expected time on a printer with these time factors, in seconds."""
        return self.overhead_s + self.sliced_s * time_factors.compute_factor(self.feature_shares)
