"""Records of a result: parts, attempts and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from decompose.arrays import Floats, Ints
from decompose.assembly import Assembly, AssemblyStep, find_order_faults, plan_assembly
from decompose.connectors import Connectors, describe_connectors
from decompose.engines.guillotine import CurvePoint
from decompose.errors import DecomposeError, GeometryError, Rule
from decompose.geometry import Solid, round_triangles
from decompose.options import Engine, Options
from decompose.pieces import Fault, Joint, Seam, describe_thin_rims, measure_seams
from decompose.printers import PrinterRoom

SCHEMA = 1
STL_TOLERANCES_MM = (0.0, 1e-5, 1e-4, 1e-3)
ON_BED_MM = 2e-5  # distance of the corners of a tilted face from its plane in single precision


@dataclass(frozen=True, slots=True)
class Part:
    """Printable piece.

    Attributes
    ----------
    solid
        In the model's frame, mm.
    to_model
        (4, 4) row-major: coordinates of the part's file (printing pose) -> model frame, mm.
    printer
        Name of the printer that it is meant for.
    brim_width_mm, layer_0_expansion_mm
        Values chosen for the part; None for those of the quality.
    bed_face_hidden, tops_hidden
        Whether the faces on the bed, and all top faces, are cut faces, which are hidden once the parts are
        glued.
    planes
        (k, 4) rows nx, ny, nz, d: the planes n.x = d that it was cut at, in the model's frame.
    hidden_sides
        (k, 3) rows nx, ny, d: the upright sides that are hidden once the parts are glued, with outward
        normals, in printing pose.
    stands
        Whether it stays upright while it is printed in its pose.
    small_foot_mm2
        Area of its first layer if it is small for the height; else None.
    drilled
        The solid with its holes and marks, which is printed; None if it has neither.
    """

    id: str
    solid: Solid
    to_model: Floats
    price_s: float
    printer: str
    file: str = ""
    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None
    bed_face_hidden: bool = False
    tops_hidden: bool = False
    planes: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    hidden_sides: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    stands: bool = True
    small_foot_mm2: float | None = None
    drilled: Solid | None = None

    @property
    def printed(self) -> Solid:
        """Solid that is printed, with holes and marks."""
        return self.solid if self.drilled is None else self.drilled

    @property
    def rotation(self) -> Floats:
        """Bed's x, y and z in the model's frame, as rows (3, 3)."""
        return self.to_model[:3, :3].T

    def build_printing_mesh(self, tolerance_mm: float = 0.0) -> tuple[Floats, Ints]:
        """Return vertices and faces in printing pose: centred on the bed's origin, standing flat on z = 0."""
        solid = self.printed.simplify(tolerance_mm) if tolerance_mm > 0.0 else self.printed
        vertices, faces = solid.arrays()
        placed_vertices = (vertices - self.to_model[:3, 3]) @ self.to_model[:3, :3]
        placed_vertices[np.abs(placed_vertices[:, 2]) < ON_BED_MM, 2] = 0.0
        return placed_vertices, faces

    def build_stl_triangles(self) -> npt.NDArray[np.float32]:
        """Return triangles (m, 3, 3) for an STL, simplified if that is necessary to keep them closed."""
        for tolerance_mm in STL_TOLERANCES_MM:
            corners = round_triangles(*self.build_printing_mesh(tolerance_mm))
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
            "volume_mm3": self.printed.volume_mm3,
            "area_mm2": self.printed.area_mm2,
            "estimated_s": self.price_s,
            "printer": self.printer,
            "brim_width_mm": self.brim_width_mm,
            "layer_0_expansion_mm": self.layer_0_expansion_mm,
            "bed_face_hidden": self.bed_face_hidden,
            "tops_hidden": self.tops_hidden,
            "hidden_sides": self.hidden_sides.tolist(),
            "stands": self.stands,
            "small_foot_mm2": self.small_foot_mm2,
        }


@dataclass(frozen=True, slots=True)
class Coverage:
    """Relative error of the original area, and volume that parts cover twice."""

    surface_error: float
    overlap_mm3: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """Outcome of one engine on one grid, of those that `best` tried.

    Attributes
    ----------
    yaw_deg
        Angle by which the model was turned about z.
    makespan_s
        Makespan of the result; None if there is none, for the cause in `reason`.
    compute_s, effort_s
        Wall time; and the work that was counted, which is the same on every machine (`problem.Effort`).
    finished
        Whether the search ended within the budget.
    """

    engine: Engine
    granularity: str | int
    yaw_deg: float = 0.0
    makespan_s: float | None = None
    compute_s: float = 0.0
    effort_s: float = 0.0
    finished: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Cutting:
    """Boxes from which the parts were cut, for a second move of the planes (`decompose.relevel`).

    Attributes
    ----------
    granularity
        Granularity of the grid.
    frame
        (3, 3) ``v_cut = frame @ v_model``.
    boxes_mm
        (parts, 2, 3) corners of the box that each part was cut from, in the frame of the cut.
    cut_for
        The printer for which each part was cut; None for any.
    printers
        Printers that were free.
    prices_s
        Price of each part in the pose that it is printed in; empty if it is not known.
    """

    granularity: str | int
    frame: Floats
    boxes_mm: Floats
    cut_for: tuple[PrinterRoom | None, ...]
    printers: tuple[PrinterRoom, ...]
    prices_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Decomposition:
    """A checked result. All times are estimates of the cost model, in seconds.

    Attributes
    ----------
    serial_s, serial_as_is_s
        Time of the whole model on one imaginary large printer: in its best pose, and as it stands in its
        file.
    makespan_s, sum_s
        Time when the last part ends, on its printer at its speed; and the sum over all parts, without speeds.
    grid_makespan_s
        The longest box of the search's partition as its tables price it: in the best of the axis poses, with
        supports down to the bed and the quality's brim; a box whose pieces were posed is priced at no less
        than their true price. `makespan_s` is for the pose that a part is printed in, and may be less or
        more.
    lower_bound_s
        Proven: no partition into boxes of this grid, of at most as many pieces as there are printers, has a
        lower `grid_makespan_s` (`bound`). It does not hold for other grids, cuts or poses. For an engine
        without a grid: no partition that prints the whole surface has a lower makespan. Both are for these
        printers at their speeds; the bound assumes that all of them are as fast as the fastest.
    any_boxes_bound_s
        Proven: no partition into boxes along these axes, on any grid or none, has a lower makespan, each box
        priced as in `grid_makespan_s`. Only for the engine `guillotine`, the best of `best`; None where no
        bound was asked for.
    gap
        (grid_makespan_s - lower_bound_s) / lower_bound_s.
    joints
        Contacts of two parts, by their indices in `parts`.
    assembly
        Steps in which the parts are glued, by their indices in `parts` and `joints`; planned when the parts
        are written (`with_assembly`), as most results are only compared.
    seams
        Seam of each of `joints`; measured with the assembly.
    connectors
        Pins and marks on the joints, from `connect_parts`.
    faults
        Slivers, and parts without joints of enough area. A result with faults is rejected, except those of
        the baselines and with `--faithful`, which report them.
    cutting
        Boxes of the engine `guillotine`, from which its planes can be moved again.
    curve
        Makespan of each number of printers by the tables, in seconds; empty unless the number was chosen.
    yaw_deg
        Angle by which `best` turned the model about z before it was cut.
    attempts
        Attempts of `best`, in order; empty for a single engine.
    open_printers
        Printers of a search that has paused before a round of several attempts; empty if it has ended.
    compute_s
        Wall time by stage of the engine of the result; ``total`` includes all attempts of `best`.
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
    cells: tuple[int, int, int] | None
    yaw_deg: float = 0.0
    attempts: tuple[Attempt, ...] = ()
    joints: tuple[Joint, ...] = ()
    assembly: Assembly = field(default_factory=Assembly)
    seams: tuple[Seam, ...] = ()
    connectors: Connectors = field(default_factory=Connectors)
    faults: tuple[Fault, ...] = ()
    curve: tuple[CurvePoint, ...] = ()
    cutting: Cutting | None = None
    open_printers: tuple[PrinterRoom, ...] = ()
    any_boxes_bound_s: float | None = None

    def compute_possible_gain(self, printers: Sequence[PrinterRoom]) -> float:
        """Compute the share of the makespan that a perfect balance of the same total work would save.

        With such a balance all printers would work until the end, each at its own speed.
        """
        busy_s = self.sum_s / sum(1.0 / printer.time_factor for printer in printers)
        return 1.0 - busy_s / self.makespan_s

    def without_parts(self) -> Decomposition:
        """Return the result with its figures only, for another process."""
        return replace(
            self, parts=(), joints=(), assembly=Assembly(), seams=(), connectors=Connectors(), faults=()
        )

    def with_assembly(self) -> Decomposition:
        """Return the result with its assembly planned; an order that fails in its replay is discarded.

        The seams are measured too; there are none if that fails.
        """
        solids = [part.solid for part in self.parts]
        assembly = plan_assembly(self.parts, self.joints, self.options.min_glue_mm2)
        if find_order_faults(solids, self.joints, assembly):
            assembly = Assembly(locked=(tuple(range(len(solids))),))
        try:
            seams = tuple(measure_seams(self.parts, self.joints))
        except (shapely.errors.ShapelyError, DecomposeError, ValueError):
            seams = ()  # the parts are valid without lengths of seams
        return replace(self, assembly=assembly, seams=seams)

    def sum_seams_mm(self, joints: Iterable[int] | None = None) -> float:
        """Add up the length of seams on the model's own surface, of some joints or of all."""
        numbers = range(len(self.seams)) if joints is None else joints
        return sum((self.seams[number].length_mm for number in numbers), start=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Build the object for decomposition.json."""
        return {
            "schema": SCHEMA,
            "engine": self.engine,
            "options": self.options.as_dict(),
            "serial_s": self.serial_s,
            "serial_as_is_s": self.serial_as_is_s,
            "makespan_s": self.makespan_s,
            "sum_s": self.sum_s,
            "grid_makespan_s": self.grid_makespan_s,
            "lower_bound_s": self.lower_bound_s,
            "any_boxes_bound_s": self.any_boxes_bound_s,
            "gap": self.gap,
            "compute_s": self.compute_s["total"],
            "stages_s": self.compute_s,
            "cells": None if self.cells is None else list(self.cells),
            "yaw_deg": self.yaw_deg,
            "attempts": [asdict(attempt) for attempt in self.attempts],
            "parts": [p.as_dict() for p in self.parts],
            "coverage": asdict(self.coverage),
            "curve": [asdict(point) for point in self.curve],
            "joints": [self._describe_joint(number, joint) for number, joint in enumerate(self.joints)],
            "seam_mm": self.sum_seams_mm(),
            "thin_rims": self.describe_thin_rims(),
            "small_feet": self.describe_small_feet(),
            "assembly": {
                "levels": self.assembly.levels,
                "estimated_s": self.assembly.total_s,
                "critical_s": self.assembly.critical_s,
                "parts": self._name_parts(self.assembly.part_order),
                "steps": [self._step_as_dict(n, step) for n, step in enumerate(self.assembly.steps, 1)],
                "locked": [self._name_parts(parts) for parts in self.assembly.locked],
            },
            "connectors": describe_connectors(self.connectors, [part.id for part in self.parts], self.joints),
            "faults": [{"part": self.parts[f.piece].id, "what": f.reason} for f in self.faults],
        }

    def describe_thin_rims(self) -> str:
        """Describe rims that are thinner than two lines, in a sentence; empty if there are none."""
        return describe_thin_rims([part.id for part in self.parts], self.joints, self.seams)

    def describe_small_feet(self) -> str:
        """Describe parts that are tall for a small first layer, in a sentence; empty if there are none."""
        feet = [f"{part.id} on {part.small_foot_mm2:.0f} mm2" for part in self.parts if part.small_foot_mm2]
        if not feet:
            return ""
        return (
            f"Small footprints for their height: {', '.join(feet)}; "
            "watch the first layers, or use a wider brim"
        )

    def _describe_joint(self, number: int, joint: Joint) -> dict[str, Any]:
        seam = self.seams[number] if self.seams else Seam()
        return {
            "a": self.parts[joint.a].id,
            "b": self.parts[joint.b].id,
            "area_mm2": joint.area_mm2,
            "width_mm": joint.width_mm,
            "glued": joint.holds(self.options.min_glue_mm2),
            "seam_mm": seam.length_mm,
            "thin_rim_mm": seam.thin_mm,
        }

    def _step_as_dict(self, number: int, step: AssemblyStep) -> dict[str, Any]:
        return {
            "number": number,
            "moved": self._name_parts(step.moved_parts),
            "fixed": self._name_parts(step.fixed_parts),
            "direction": (step.direction + 0.0).tolist(),  # no -0
            "joints": [self._name_parts((self.joints[j].a, self.joints[j].b)) for j in step.joints],
            "glue_mm2": step.glue_mm2,
            "slides": step.slides,
            "rests_on": self._name_parts(step.rests_on),
            "level": step.level,
            "work_s": step.work_s,
            "starts_s": step.starts_s,
            "seam_mm": self.sum_seams_mm(step.joints if self.seams else ()),
            "pins": [n for n, pin in enumerate(self.connectors.pins, 1) if pin.step == number - 1],
            "codes": [
                {"part": self.parts[mark.part].id, "text": mark.text}
                for mark in self.connectors.marks
                if mark.joint in step.joints
            ],
        }

    def _name_parts(self, numbers: Sequence[int]) -> list[str]:
        return [self.parts[number].id for number in numbers]
