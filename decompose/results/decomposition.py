"""A result of a decomposition: its parts and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from decompose.arrays import Floats, Ints
from decompose.assembly import Assembly, AssemblyStep, find_order_faults, plan_assembly
from decompose.connectors import Connectors, describe_connectors
from decompose.engines.guillotine import CurvePoint
from decompose.errors import DecomposeError, GeometryError, Rule
from decompose.geometry import Solid, round_triangles, separate_touching_surfaces
from decompose.options import Engine, Options
from decompose.pieces import Fault, Joint, Seam, describe_thin_rims, measure_seams
from decompose.printers import TargetPrinter
from decompose.results.records import Attempt, Coverage, Cutting

SCHEMA_VERSION = 1
STL_TOLERANCES_MM = (0.0, 1e-5, 1e-4, 1e-3)
# Distance by which touching surfaces are moved apart; it exceeds the rounding error of a coordinate of 1 m.
STL_GAP_MM = 1e-4
BED_TOLERANCE_MM = 2e-5  # corners this close to the bed are on it; rounding to float32 moves them


@dataclass(frozen=True, slots=True)
class Part:
    """A printable part.

    Attributes
    ----------
    id
        Name of the part, such as `p07`.
    solid
        Solid in the model's frame, in mm.
    to_model
        (4, 4) rigid transform from the printing pose, in which the STL file is, to the model's frame, in mm.
    price_s
        Estimated print time.
    printer
        Name of the printer to which the part is assigned.
    file
        Name of the part's STL file; empty before it is written.
    brim_width_mm, layer_0_expansion_mm
        Values chosen for the part; None if those of the print settings are used.
    bed_face_hidden, tops_hidden
        Whether the faces on the bed, and all top faces, are cut faces, which are hidden once the parts are
        glued.
    flat_tops_visible
        Whether flat tops remain visible once the parts are glued.
    planes
        (k, 4) planes ``n @ x == d`` at which the part was cut, in the model's frame: rows nx, ny, nz, d.
    hidden_sides
        (k, 3) upright sides that are hidden once the parts are glued, in printing pose: rows nx, ny, d with
        an outward normal.
    hidden_grooves
        (g, 4) grooves for keys in these sides: see `list_hidden_grooves`.
    hidden_recesses
        (r, 6) marks and grooves for keys in level faces: see `list_hidden_recesses`.
    stands
        Whether the part stays upright while it is printed in its pose.
    small_foot_mm2
        Area of the first layer if this is small for the height of the part; otherwise None.
    drilled_solid
        Solid with holes and marks, which is printed; None if the part has neither.
    connectors_s
        Share of `price_s` for marks and pins: estimated from the area of the cut faces until the part is
        drilled, then computed from the marks and pins that it has.
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
    flat_tops_visible: bool = True
    planes: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    hidden_sides: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    hidden_grooves: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    hidden_recesses: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    stands: bool = True
    small_foot_mm2: float | None = None
    drilled_solid: Solid | None = None
    connectors_s: float = 0.0

    @property
    def printed_solid(self) -> Solid:
        """Solid that is printed, with its holes and marks."""
        return self.solid if self.drilled_solid is None else self.drilled_solid

    @property
    def bare_price_s(self) -> float:
        """Estimated print time without marks and pins."""
        return self.price_s - self.connectors_s

    @property
    def rotation(self) -> Floats:
        """Rotation (3, 3) into the printing pose: rows are the bed's x, y and z in the model's frame."""
        return self.to_model[:3, :3].T

    def build_printing_mesh(self, tolerance_mm: float = 0.0) -> tuple[Floats, Ints]:
        """Build the mesh in printing pose, centred on the bed's origin and standing flat on z = 0.

        Parameters
        ----------
        tolerance_mm
            Tolerance to which the mesh is simplified; 0 to keep all triangles.

        Returns
        -------
        tuple
            (n, 3) vertices in mm, and (m, 3) faces.
        """
        solid = self.printed_solid.simplify(tolerance_mm) if tolerance_mm > 0.0 else self.printed_solid
        vertices, faces = solid.arrays()
        placed_vertices = (vertices - self.to_model[:3, 3]) @ self.to_model[:3, :3]
        placed_vertices[np.abs(placed_vertices[:, 2]) < BED_TOLERANCE_MM, 2] = 0.0
        return placed_vertices, faces

    def build_stl_triangles(self) -> npt.NDArray[np.float32]:
        """Build the triangles (m, 3, 3) float32 in mm of the part's STL file.

        The surface is simplified, or moved apart where it touches itself, if this is necessary to keep it
        closed: STL files have no shared vertices, so two edges at the same place look like one edge with four
        faces.

        Raises
        ------
        GeometryError
            The surface touches itself, so its STL file cannot be closed.
        """
        for gap_mm, tolerance_mm in product((0.0, STL_GAP_MM), STL_TOLERANCES_MM):
            vertices, faces = self.build_printing_mesh(tolerance_mm)
            if gap_mm:
                vertices = separate_touching_surfaces(vertices, faces, gap_mm)
            corners = round_triangles(vertices, faces)
            if corners is not None:
                return corners
        raise GeometryError(Rule.STL, self.id, "touches itself, so its STL file is not closed")

    def as_dict(self) -> dict[str, Any]:
        """Build the object that describes the part in decomposition.json."""
        lo_mm, hi_mm = self.solid.bounds_mm
        return {
            "id": self.id,
            "file": self.file,
            "to_model": self.to_model.tolist(),
            "min_mm": lo_mm.tolist(),
            "max_mm": hi_mm.tolist(),
            "volume_mm3": self.printed_solid.volume_mm3,
            "area_mm2": self.printed_solid.area_mm2,
            "estimated_s": self.price_s,
            "printer": self.printer,
            "brim_width_mm": self.brim_width_mm,
            "layer_0_expansion_mm": self.layer_0_expansion_mm,
            "bed_face_hidden": self.bed_face_hidden,
            "tops_hidden": self.tops_hidden,
            "flat_tops_visible": self.flat_tops_visible,
            "hidden_sides": self.hidden_sides.tolist(),
            "hidden_grooves": self.hidden_grooves.tolist(),
            "hidden_recesses": self.hidden_recesses.tolist(),
            "stands": self.stands,
            "small_foot_mm2": self.small_foot_mm2,
        }


@dataclass(frozen=True, slots=True)
class Decomposition:
    """A checked result. All times are estimates of the cost model, in seconds.

    Attributes
    ----------
    engine, options
        Engine that made the result, and options of the decomposition.
    serial_s, serial_as_is_s
        Time of the whole model on one imaginary large printer: in its best pose, and in the pose of its file.
    makespan_s, sum_s
        Longest time of a part on its printer, at the speed of that printer; sum of the prices of all parts,
        without the speeds of printers.
    grid_makespan_s
        Makespan of the boxes of the partition according to the table of prices. The table prices each box in
        the best of its axis-aligned poses. It assumes supports down to the bed, and the brim of the print
        settings. If poses were found for the pieces of a box, the price of the box is at least the highest
        price of these poses. `makespan_s` refers to the printing poses, and may be less or more.
    lower_bound_s
        Proven bound (`bound`): no partition into boxes of this grid has a lower `grid_makespan_s`, if it has
        no more pieces than there are printers. The bound does not hold for other grids, cuts or poses. For an
        engine without a grid, no partition that prints the whole surface has a lower makespan. Both bounds
        assume that all printers are as fast as the fastest one.
    any_boxes_bound_s
        Proven bound: no partition into boxes along these axes, whether on a grid or not, has a lower
        makespan, if boxes are priced as in `grid_makespan_s`. It is computed only if a bound was requested
        and the engine is `guillotine`, alone or in `best`; otherwise None.
    gap
        (grid_makespan_s - lower_bound_s) / lower_bound_s.
    parts
        Parts in the order of their numbers.
    coverage
        Relative difference between the area of the parts without their cut faces and the area of the model,
        and volume in which parts overlap.
    cells
        Shape of the grid; None without a grid.
    joints
        Contacts of two parts, by their indices in `parts`.
    assembly
        Steps in which the parts are glued, by their indices in `parts` and `joints`. It is planned when the
        parts are written (`with_assembly`), because most results are only compared.
    seams
        Seams of the `joints`, in the same order; they are measured when the assembly is planned.
    connectors
        Pins and marks on the joints, from `connect_parts`.
    faults
        Slivers, and parts without joints of sufficient area. Baselines and `--faithful` report them; any
        other result with faults is rejected.
    cutting
        Boxes into which the engine `guillotine` cut the model; with them, the planes can be moved again.
    curve
        Makespan for each number of printers according to the table of prices, in seconds; empty unless `auto`
        chose the number.
    yaw_deg
        Angle by which `best` rotated the model about z before it was cut.
    attempts
        Attempts of `best`, in order; empty for a single engine.
    open_printers
        Printers of a search by `best` that has paused before several attempts, which can run side by side;
        empty if the search has ended.
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
    open_printers: tuple[TargetPrinter, ...] = ()
    any_boxes_bound_s: float | None = None

    def compute_possible_gain(self, printers: Sequence[TargetPrinter]) -> float:
        """Compute the share of the makespan that a perfect balance of the same total work would save.

        With such a balance, all printers would work until the end, each at its own speed.
        """
        balanced_s = self.sum_s / sum(1.0 / printer.time_factor for printer in printers)
        return 1.0 - balanced_s / self.makespan_s

    def without_parts(self) -> Decomposition:
        """Return the result without its parts and all that refers to them, to send it to another process."""
        return replace(
            self, parts=(), joints=(), assembly=Assembly(), seams=(), connectors=Connectors(), faults=()
        )

    def with_assembly(self) -> Decomposition:
        """Plan the assembly and measure the seams; return the result with both.

        An order that fails in the replay is discarded. There are no seams if their measurement fails.
        """
        solids = [part.solid for part in self.parts]
        assembly = plan_assembly(self.parts, self.joints, self.options.min_glue_mm2)
        if find_order_faults(solids, self.joints, assembly):
            assembly = Assembly(locked_sets=(tuple(range(len(solids))),))
        try:
            seams = tuple(measure_seams(self.parts, self.joints))
        except (shapely.errors.ShapelyError, DecomposeError, ValueError):
            seams = ()  # the parts are valid even if their seams are not measured
        return replace(self, assembly=assembly, seams=seams)

    def sum_seams_mm(self, joints: Iterable[int] | None = None) -> float:
        """Sum the length of the seams on the model's own surface, for some joints or for all."""
        numbers = range(len(self.seams)) if joints is None else joints
        return sum((self.seams[number].length_mm for number in numbers), start=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Build the object that describes the result in decomposition.json."""
        return {
            "schema": SCHEMA_VERSION,
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
            "curve": [{"printers": p.printer_count, "makespan_s": p.makespan_s} for p in self.curve],
            "joints": [self._describe_joint(number, joint) for number, joint in enumerate(self.joints)],
            "seam_mm": self.sum_seams_mm(),
            "thin_rims": self.describe_thin_rims(),
            "small_feet": self.describe_small_feet(),
            "assembly": {
                "levels": self.assembly.level_count,
                "estimated_s": self.assembly.total_s,
                "critical_s": self.assembly.critical_path_s,
                "parts": self._name_parts(self.assembly.part_order),
                "steps": [self._describe_step(n, step) for n, step in enumerate(self.assembly.steps, 1)],
                "locked": [self._name_parts(parts) for parts in self.assembly.locked_sets],
            },
            "connectors": describe_connectors(self.connectors, [part.id for part in self.parts], self.joints),
            "faults": [{"part": self.parts[f.piece_number].id, "what": f.reason} for f in self.faults],
        }

    def describe_thin_rims(self) -> str:
        """Describe thin rims (`Seam.thin_length_mm`) in a sentence; empty if they are too short to report."""
        return describe_thin_rims([part.id for part in self.parts], self.joints, self.seams)

    def describe_small_feet(self) -> str:
        """Describe parts whose first layer is small for their height, in a sentence; empty if none are."""
        feet = [f"{part.id} on {part.small_foot_mm2:.0f} mm2" for part in self.parts if part.small_foot_mm2]
        if not feet:
            return ""
        return (
            f"Parts with a small footprint for their height: {', '.join(feet)}; "
            "watch the first layers, or use a wider brim"
        )

    def _describe_joint(self, number: int, joint: Joint) -> dict[str, Any]:
        """Build the object that describes a joint in decomposition.json."""
        seam = self.seams[number] if self.seams else Seam()
        return {
            "a": self.parts[joint.a].id,
            "b": self.parts[joint.b].id,
            "area_mm2": joint.area_mm2,
            "width_mm": joint.width_mm,
            "glued": joint.holds(self.options.min_glue_mm2),
            "seam_mm": seam.length_mm,
            "thin_rim_mm": seam.thin_length_mm,
        }

    def _describe_step(self, number: int, step: AssemblyStep) -> dict[str, Any]:
        """Build the object that describes a step of the assembly in decomposition.json."""
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
            "starts_s": step.start_s,
            "seam_mm": self.sum_seams_mm(step.joints if self.seams else ()),
            "pins": [n for n, pin in enumerate(self.connectors.pins, 1) if pin.step == number - 1],
            "codes": [
                {"part": self.parts[mark.part].id, "text": mark.text}
                for mark in self.connectors.marks
                if mark.joint in step.joints
            ],
        }

    def _name_parts(self, numbers: Sequence[int]) -> list[str]:
        """List the names of parts by their numbers."""
        return [self.parts[number].id for number in numbers]
