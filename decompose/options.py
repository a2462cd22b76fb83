"""Options of a decomposition: the engine, options for all engines, and options for single engines."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

MIN_GLUE_MM2 = 25.0
"""Minimum area of a glued joint, 5 mm x 5 mm: enough to hold a part the size of a hand."""
BUDGET_S = 20.0
FILAMENT_MM = 2.85
THIN_FILAMENT_MM = 1.75
MIN_PIN_MM, MAX_PIN_MM = 1.0, 10.0
PIN_FIT_MM = 0.4
"""[assumed] Clearance of a printed hole: width across the flats minus the diameter of its filament pin."""


class PairShape(NamedTuple):
    """Shape of a pair of pins, seen along the direction of their step.

    Attributes
    ----------
    distance_mm
        Distance between the two pins.
    angles
        Angle from the line between them to each key, in radians modulo pi; None for a pin in a hole.
    lengths_mm
        Lengths of the two pins.
    """

    distance_mm: float
    angles: tuple[float | None, float | None]
    lengths_mm: tuple[float, float]


class Engine(StrEnum):
    """Engine that cuts a model."""

    BEST = "best"  # `decompose.best`: several engines and grids, within a budget
    GUILLOTINE = "guillotine"
    PARALLELOBOX = "parallelobox"
    SYMMETRY = "symmetry"
    CUBE_SKELETON = "cube-skeleton"


class Interior(StrEnum):
    """Treatment of the grid cells that are deep inside the model."""

    LEAVE = "leave"  # they are left out: not printed
    KEEP = "keep"  # they are printed


class Score(StrEnum):
    """Interpretation of the score of a growth direction in the engine `parallelobox`."""

    LOW = "low"  # the lowest score is best
    HIGH = "high"  # the highest score is best, as in the paper's text
    BOTH = "both"  # both are evaluated, and the better result is used

    @property
    def interpretations(self) -> tuple[Score, ...]:
        """Interpretations to evaluate, each `LOW` or `HIGH`."""
        return (Score.LOW, Score.HIGH) if self is Score.BOTH else (self,)


@dataclass(frozen=True, slots=True)
class BestOptions:
    """Options of the engine `best`.

    Attributes
    ----------
    budget_s
        Maximum work, counted in seconds of one core of a typical machine (`problem.Effort`): once it is
        spent, no engine is started and no search is continued.
    pauses
        Whether the search pauses before a round of several attempts, so that the caller can run them in
        parallel (`decompose.paused_search`).
    """

    budget_s: float = BUDGET_S
    pauses: bool = False


@dataclass(frozen=True, slots=True)
class ParalleloboxOptions:
    """Options of the engine `parallelobox`.

    Attributes
    ----------
    tries
        Number of random sets of seeds to try for each number of seeds.
    score
        Interpretation of the score in the paper.
    """

    tries: int = 3
    score: Score = Score.BOTH


@dataclass(frozen=True, slots=True)
class ConnectorOptions:
    """Options of the pins and marks on the faces that are glued.

    Attributes
    ----------
    pin_mm
        Diameter of the pins; None if there are none.
    pin_fit_mm
        Clearance of a hole: width across the flats minus the diameter of the pin.
    marks
        Whether the numbers of the parts are cut into these faces.
    printer_fits_mm
        Name of each printer for which the clearance of a hole differs from `pin_fit_mm`, and this clearance.
    used_shapes
        Shapes of the pairs of pins in existing joints, for example in the neighbours of a part that is cut
        again. New pairs are unlike them.
    """

    pin_mm: float | None = None
    pin_fit_mm: float = PIN_FIT_MM
    marks: bool = False
    printer_fits_mm: tuple[tuple[str, float], ...] = ()
    used_shapes: tuple[PairShape, ...] = ()

    @property
    def is_empty(self) -> bool:
        """True if there are neither pins nor marks."""
        return self.pin_mm is None and not self.marks

    def find_fit_mm(self, printer: str) -> float:
        """Find the clearance of the holes in parts that a printer prints."""
        return dict(self.printer_fits_mm).get(printer, self.pin_fit_mm)


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a decomposition.

    Attributes
    ----------
    engine
        Engine that cuts the model.
    granularity
        Cube root of the number of grid cells: a name of `grid.GRANULARITIES`, a number, or ``auto``.
    interior
        Treatment of the grid cells that are deep inside the model.
    min_wall_mm
        Minimum thickness of the wall around a hollow.
    min_glue_mm2
        Minimum area of a glued joint that counts as holding. The joint must also be as wide as two lines of
        wall (`pieces.joints.TWO_WALLS_MM`).
    seed
        Seed of the random numbers of the engines; the engine `guillotine` uses none.
    faithful
        Whether an engine from the literature runs as its authors describe it, with their prices and settings.
    fit_first_layer
        Whether the widths of the brim and of the first-layer expansion are chosen for each part.
    prove
        Whether the lower bound is proven by linear programming, which takes some seconds; otherwise the bound
        is looser.
    best, parallelobox
        Options of these engines.
    connectors
        Pins and marks.
    """

    engine: Engine = Engine.BEST
    granularity: str | int = "auto"
    interior: Interior = Interior.LEAVE
    min_wall_mm: float = 10.0
    min_glue_mm2: float = MIN_GLUE_MM2
    seed: int = 0
    faithful: bool = False
    fit_first_layer: bool = True
    prove: bool = True
    best: BestOptions = BestOptions()
    parallelobox: ParalleloboxOptions = ParalleloboxOptions()
    connectors: ConnectorOptions = ConnectorOptions()

    def as_dict(self) -> dict[str, Any]:
        """Build the object for decomposition.json: flat, with the options of all engines."""
        return {
            "engine": self.engine,
            "granularity": self.granularity,
            "interior": self.interior,
            "min_wall_mm": self.min_wall_mm,
            "min_glue_mm2": self.min_glue_mm2,
            "seed": self.seed,
            "tries": self.parallelobox.tries,
            "score": self.parallelobox.score,
            "faithful": self.faithful,
            "fit_first_layer": self.fit_first_layer,
            "budget_s": self.best.budget_s,
            "prove": self.prove,
            "pin_mm": self.connectors.pin_mm,
            "pin_fit_mm": self.connectors.pin_fit_mm,
            "marks": self.connectors.marks,
        }
