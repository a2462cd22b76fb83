"""What decomposition answers: parts, figures, and how they are written to a folder."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decompose.assembly import draw_assembly
from decompose.check import Coverage, Rule, check_stl
from decompose.errors import GeometryError
from decompose.growth import Score
from decompose.solid import Solid
from decompose.stl import single_precision, write_stl

SCHEMA = 1
STL_TOLERANCES_MM = (0.0, 1e-5, 1e-4, 1e-3)
ON_BED_MM = 2e-5  # single precision leaves the corners of a tilted face this far from its plane
Floats = npt.NDArray[np.float64]


class Engine(StrEnum):
    """How the model is cut."""

    GUILLOTINE = "guillotine"
    PARALLELOBOX = "parallelobox"


class Interior(StrEnum):
    """What becomes of whole cells deep inside the model."""

    LEAVE = "leave"  # not printed
    KEEP = "keep"


@dataclass(frozen=True, slots=True)
class Options:
    """How to decompose. `granularity` is a name of `decompose.grid.GRANULARITY`, a number, or ``auto``."""

    engine: Engine = Engine.GUILLOTINE
    granularity: str | int = "auto"
    interior: Interior = Interior.LEAVE
    min_wall_mm: float = 10.0
    seed: int = 0  # for engines that draw; the guillotine engine does not
    tries: int = 3  # of parallelobox, for each number of seeds
    score: Score = Score.LOW  # of parallelobox
    faithful: bool = False  # parallelobox with the paper's own prices and settings
    fit_first_layer: bool = True  # choose each part's brim and first-layer expansion
    prove: bool = True  # the bound by linear programming: some seconds; without it the gap is wide


@dataclass(frozen=True, slots=True)
class Part:
    """One printable piece.

    Attributes
    ----------
    solid
        In the model's frame, mm.
    to_model
        (4, 4) row-major: coordinates of the part's file (printing pose) -> model frame, mm.
    printer
        The name of the printer that it is meant for.
    brim_width_mm, layer_0_expansion_mm
        Chosen for the part; None: as the quality has them.
    box_mm
        (2, 3) corners of the box that it was cut out of, in the model's frame; infinite where there is none.
    """

    id: str
    solid: Solid
    to_model: Floats
    estimated_s: float
    printer: str
    file: str = ""
    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None
    box_mm: Floats = field(default_factory=lambda: np.array([[-np.inf] * 3, [np.inf] * 3]))

    @property
    def rotation(self) -> Floats:
        """(3, 3) rows: the bed's x, y and z in the model's frame."""
        return self.to_model[:3, :3].T

    def printed(self, tolerance_mm: float = 0.0) -> tuple[Floats, npt.NDArray[np.int64]]:
        """Vertices and faces in printing pose: centred on the bed's origin, standing flat on z = 0."""
        solid = self.solid.simplify(tolerance_mm) if tolerance_mm > 0.0 else self.solid
        vertices, faces = solid.arrays()
        placed = (vertices - self.to_model[:3, 3]) @ self.to_model[:3, :3]
        placed[np.abs(placed[:, 2]) < ON_BED_MM, 2] = 0.0
        return placed, faces

    def triangles(self) -> npt.NDArray[np.float32]:
        """Triangles (m, 3, 3) for an STL, simplified by as little as keeps them closed in its precision."""
        for tolerance_mm in STL_TOLERANCES_MM:
            corners = single_precision(*self.printed(tolerance_mm))
            if corners is not None:
                return corners
        raise GeometryError(Rule.STL, self.id, "touches itself, so that an STL of it is not closed")

    def as_dict(self) -> dict[str, Any]:
        lo, hi = self.solid.bounds_mm
        return {
            "id": self.id,
            "file": self.file,
            "to_model": self.to_model.tolist(),
            "min_mm": lo.tolist(),
            "max_mm": hi.tolist(),
            "volume_mm3": self.solid.volume_mm3,
            "area_mm2": self.solid.area_mm2,
            "estimated_s": self.estimated_s,
            "printer": self.printer,
            "brim_width_mm": self.brim_width_mm,
            "layer_0_expansion_mm": self.layer_0_expansion_mm,
        }


@dataclass(frozen=True, slots=True)
class Decomposition:
    """A checked result. All times are estimates of the cost model, in seconds.

    Attributes
    ----------
    serial_s, serial_as_is_s
        The whole model on one imagined large printer: in its best pose, and as it stands in its file.
    makespan_s, sum_s
        The longest part, and all parts together.
    grid_makespan_s
        The longest box as the tables price it: in the best of its axis poses, with supports down to the bed
        and the quality's brim. `makespan_s` is of the pose that a part is printed in, and may be either side.
    lower_bound_s
        Proven: no partition into boxes of this grid, of at most as many pieces as there are printers, has a
        lower `grid_makespan_s` (`decompose.bound`). It says nothing of other grids, cuts or poses.
    gap
        (grid_makespan_s - lower_bound_s) / lower_bound_s.
    compute_s
        Wall time of the decomposition, by stage; ``total`` is all.
    """

    engine: Engine
    options: Options
    serial_s: float
    serial_as_is_s: float
    makespan_s: float
    sum_s: float
    grid_makespan_s: float
    lower_bound_s: float
    gap: float
    compute_s: dict[str, float]
    parts: tuple[Part, ...]
    coverage: Coverage
    cells: tuple[int, int, int]

    def as_dict(self) -> dict[str, Any]:
        """The object that decomposition.json holds."""
        return {
            "schema": SCHEMA,
            "engine": self.engine,
            "options": asdict(self.options),
            "serial_s": self.serial_s,
            "serial_as_is_s": self.serial_as_is_s,
            "makespan_s": self.makespan_s,
            "sum_s": self.sum_s,
            "grid_makespan_s": self.grid_makespan_s,
            "lower_bound_s": self.lower_bound_s,
            "gap": self.gap,
            "compute_s": self.compute_s["total"],
            "stages_s": self.compute_s,
            "cells": list(self.cells),
            "parts": [p.as_dict() for p in self.parts],
            "coverage": asdict(self.coverage),
        }


def write(decomposition: Decomposition, folder: Path) -> Decomposition:
    """Write one binary STL a part, decomposition.json and assembly.png, and read each STL back.

    Returns
    -------
    Decomposition
        The same, with the parts' file names.

    Raises
    ------
    GeometryError
        An STL, read back, is not watertight or has another volume.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for part in decomposition.parts:
        named = replace(part, file=f"{part.id}.stl")
        write_stl(folder / named.file, named.triangles())
        check_stl(folder / named.file, named)
        parts.append(named)
    written = replace(decomposition, parts=tuple(parts))
    text = json.dumps(written.as_dict(), indent=1) + "\n"
    (folder / "decomposition.json").write_text(text, encoding="utf-8")
    draw_assembly(written.parts, folder / "assembly.png")
    return written
