"""Marks and supports read back from the G-code of drilled parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely

from bench.prices.parts import ENDLESS_BED
from decompose.arrays import Bools, Floats
from decompose.connectors import Mark
from decompose.connectors.strokes import (
    GAP,
    LETTERS,
    draw_strokes,
    list_letter_middles,
    measure_text_width,
)
from decompose.geometry import Solid, write_stl
from decompose.results import Part
from drivers.printers import SLICING_PROFILES
from farm.model import PartPrintOptions
from farm.planning.parts.slice_part import place_hidden_recesses, place_hidden_sides
from farm.planning.printer_settings import build_slicing_printer
from slicing.checks import read_toolpath, read_wall_layout
from slicing.checks.toolpath import Toolpath
from slicing.checks.walls import WallLayout, Walls
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import PartSettings, SettingsRequest, find_engine, find_resources, resolve_settings

PRINTER_MODEL = "ultimaker2_plus"
READ_DEPTH_MM = 0.2  # depth below a face at which its grooves are read
POINT_PITCH = 0.25  # pitch of the points of a letter, on the grid of the letters
LETTER_MARGIN = 0.75  # margin around the box of a letter, on that grid
MIN_READ_SHARE = 0.8  # minimum share of the points of a legible arrow or dot


@dataclass(frozen=True, slots=True, eq=False)
class SlicedPart:
    """Slice of a part: its path, its outer walls, and the transform (4, 4) from the frame of the joints."""

    path: Toolpath
    walls: Walls
    layout: WallLayout
    to_print: Floats
    sliced_s: float

    @property
    def support_filament_mm(self) -> float:
        """Length of the filament in supports, in mm."""
        is_support = self.path.is_feature("SUPPORT") | self.path.is_feature("SUPPORT-INTERFACE")
        # An unretraction extrudes without a move in the plane.
        is_move = (self.path.start[:, :2] != self.path.end[:, :2]).any(axis=1)
        return float(self.path.extruded_mm[is_support & is_move].clip(min=0.0).sum())

    def find_seams(self, longest_only: bool = False) -> Floats:
        """Find the points (n, 3), in the joints' frame, where rings of the outer wall begin.

        Parameters
        ----------
        longest_only
            Whether to use only the longest ring of each layer, which is not around a hole.
        """
        walls = self.walls
        starts = np.flatnonzero(np.diff(walls.run, prepend=-1))
        starts = starts[walls.is_closed[starts]]
        if longest_only:
            lengths_mm = np.bincount(walls.run, np.hypot(*(walls.end - walls.start).T))[walls.run[starts]]
            sorted_starts = starts[np.lexsort((-lengths_mm, walls.layer[starts]))]
            starts = sorted_starts[np.diff(walls.layer[sorted_starts], prepend=-1) > 0]
        z_mm = self.layout.layer_height_0_mm + self.layout.layer_height_mm * (walls.layer[starts] - 0.5)
        placed_mm = np.column_stack([walls.start[starts], z_mm]) - self.to_print[:3, 3]
        return np.asarray(placed_mm @ np.linalg.inv(self.to_print[:3, :3]).T)

    def is_printed(self, points_mm: Floats) -> Bools:
        """Check which points (n, 3) of the joints' frame are within the outer walls of their layer."""
        placed_mm = points_mm @ self.to_print[:3, :3].T + self.to_print[:3, 3]
        layers = 1 + np.floor((placed_mm[:, 2] - self.layout.layer_height_0_mm) / self.layout.layer_height_mm)
        layers = layers.clip(0, self.walls.layer.max()).astype(np.int64)
        is_inside = np.zeros(len(points_mm), dtype=np.bool_)
        for layer in np.unique(layers):
            area = self.walls.build_printed_area(int(layer), _WHOLE_BED)
            on_layer = layers == layer
            is_inside[on_layer] = shapely.contains_xy(area, placed_mm[on_layer, :2])
        return is_inside

    def is_legible(self, mark: Mark) -> bool:
        """Check whether a mark can be read: letters match their own strokes best, arrows and dots exist."""
        direction, depth_mm = mark.grooves[0].inward_normal, measure_depth_mm(mark)
        code, stroke_count = mark.text.rstrip("^."), 0
        if code:
            strokes = draw_strokes(code)
            stroke_count = len(strokes)
            if "".join(self._read_letters(mark, code, strokes, depth_mm)) != code:
                return False
        sign_points = np.concatenate(
            [np.linspace(start, end, 5) for start, end in mark.lines_mm[stroke_count:]] or [np.zeros((0, 3))]
        )
        return (
            not len(sign_points)
            or (~self.is_printed(sign_points + READ_DEPTH_MM * direction)).mean() >= MIN_READ_SHARE
        )

    def _read_letters(self, mark: Mark, code: str, strokes: Floats, depth_mm: float) -> Iterator[str]:
        stroke_points = np.column_stack([strokes.reshape(-1, 2), np.ones(2 * len(strokes))])
        to_face = np.linalg.lstsq(stroke_points, mark.lines_mm[: len(strokes)].reshape(-1, 3), rcond=None)[0]
        scale = float(np.linalg.norm(to_face[1]))
        half_width = round(max(0.3, (depth_mm - READ_DEPTH_MM) / scale), 3)
        for own_letter, middle in zip(code, list_letter_middles(code), strict=True):
            # Farther points are in the strokes of the next letter, because letters have different widths.
            is_own = np.abs(_LETTER_GRID[:, 0]) <= (measure_text_width(own_letter) + GAP) / 2.0
            grid = _LETTER_GRID[is_own] + np.array([middle, 0.0])
            points_mm = np.column_stack([grid, np.ones(len(grid))]) @ to_face
            is_missing = ~self.is_printed(points_mm + READ_DEPTH_MM * mark.grooves[0].inward_normal)
            yield max(
                _READABLE_LETTERS,
                key=lambda letter: _correlate_letters(letter, half_width, is_own, is_missing),
            )


def measure_depth_mm(mark: Mark) -> float:
    """Measure the depth of the grooves of a mark."""
    return float(
        (mark.grooves[0].points_mm @ mark.grooves[0].inward_normal).max() - mark.grooves[0].face_offset_mm
    )


def slice_part(part: Part, solid: Solid, folder: Path) -> SlicedPart:
    """Slice a part in its pose as in quality `glue`, with its hidden faces, on an endless bed."""
    resources = find_resources()
    request = SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]))
    plain_settings = resolve_settings(request, resources)
    scale = np.array([plain_settings.scale_xy, plain_settings.scale_xy, plain_settings.scale_z])
    vertices, faces = solid.arrays()
    placed_mm = (vertices - part.to_model[:3, 3]) @ part.to_model[:3, :3] * scale
    shift = np.array([*-(placed_mm.min(axis=0) + placed_mm.max(axis=0))[:2] / 2.0, -placed_mm[:, 2].min()])
    settings = resolve_settings(
        request,
        resources,
        PartSettings(
            float(np.ptp(placed_mm[:, 2])),
            part.brim_width_mm,
            part.layer_0_expansion_mm,
            bed_face_hidden=part.bed_face_hidden,
            tops_hidden=part.tops_hidden,
            flat_tops_visible=part.flat_tops_visible,
        ),
    )
    to_bed = np.diag([*scale, 1.0])
    to_bed[:3, 3] = shift
    options = PartPrintOptions.model_validate(
        {
            "hidden_sides": part.hidden_sides.tolist(),
            "hidden_grooves": part.hidden_grooves.tolist(),
            "hidden_recesses": part.hidden_recesses.tolist(),
        }
    )
    stl, output = folder / "part.stl", folder / "part.gcode"
    write_stl(stl, (placed_mm + shift)[faces].astype(np.float32))
    result = slice_plate(
        PlateRequest(
            stl=stl,
            settings=settings,
            output_path=output,
            engine=find_engine(),
            bed=ENDLESS_BED,
            hidden_sides=place_hidden_sides(options, to_bed),
            hidden_recesses=place_hidden_recesses(options, to_bed),
        )
    )
    path, layout = read_toolpath(output.read_bytes()), read_wall_layout(settings)
    if layout is None:
        raise ValueError("the settings of quality glue have no exact outline")
    centre = tuple(
        float(side) / 2.0 for side in (settings.global_["machine_width"], settings.global_["machine_depth"])
    )
    to_print = np.eye(4)
    to_print[:3, :3] = scale[:, None] * part.to_model[:3, :3].T
    to_print[:3, 3] = shift - to_print[:3, :3] @ part.to_model[:3, 3]
    walls = Walls.from_toolpath(path, layout, (centre[0], centre[1]), settings.filament_mm2)
    return SlicedPart(path, walls, layout, to_print, result.sliced_s)


_READABLE_LETTERS = [letter for letter in LETTERS if letter not in ".^"]
_WHOLE_BED = shapely.box(-1e4, -1e4, 1e4, 1e4)
_LETTER_GRID = np.stack(
    np.meshgrid(
        np.arange(-2.0 - LETTER_MARGIN, 2.0 + LETTER_MARGIN + POINT_PITCH / 2, POINT_PITCH),
        np.arange(-3.0 - LETTER_MARGIN, 3.0 + LETTER_MARGIN + POINT_PITCH / 2, POINT_PITCH),
    ),
    axis=-1,
).reshape(-1, 2)


@lru_cache(maxsize=1024)
def _mask_strokes(letter: str, half_width: float) -> Bools:
    """Find the points of a letter that are within its strokes."""
    lines = shapely.union_all([shapely.LineString(stroke) for stroke in draw_strokes(letter)])
    return np.asarray(shapely.contains_xy(lines.buffer(half_width), _LETTER_GRID))


def _correlate_letters(letter: str, half_width: float, is_own: Bools, is_missing: Bools) -> float:
    """Compute the correlation between the missing points of a letter and the strokes of another.

    Parameters
    ----------
    letter, half_width
        The other letter, and half the width of its strokes.
    is_own
        (n,) points of `_LETTER_GRID` around the first letter.
    is_missing
        (k,) which of them are missing.
    """
    is_stroke = _mask_strokes(letter, half_width)[is_own]
    if len({*is_missing.tolist()}) < 2 or len({*is_stroke.tolist()}) < 2:
        return 0.0
    return float(np.corrcoef(is_stroke, is_missing)[0, 1])
