"""Comparison of each layer's printed outline with the mesh's section, for missing and for extra areas.

First the areas and first moments of all sections and of all printed outlines are compared, computed from
their segments by Green's theorem. Only the layers that differ are compared as polygons, which show the place
of the difference, and whether the missing area is thinner than a line. A thin area is reported; any other
missing or extra area rejects the slice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import shapely
from shapely import Geometry

from slicing.checks.section import Floats, Rings, cut_sections, measure_rings
from slicing.checks.toolpath import Toolpath
from slicing.checks.walls import TOLERANCE_MM, WallLayout, Walls
from slicing.errors import Rule, SliceRejected

SLACK_MM2, SLACK_MM = 0.5, 0.005
"""Difference of a layer's area up to which its polygons are not compared: a constant, plus an amount for each
mm of outline. Nearly all layers of sound models stay below it."""
MIN_WALL_MM2 = 5.0
"""Minimum area of a wall that is reported."""
MIN_REJECTED_MM2 = 1.0
"""Minimum area of a missing or extra piece for which a slice is rejected."""
MAX_LOST_MM2, MAX_LOST_SHARE = 50.0, 0.02
"""Maximum area that the inner walls may lack: a constant, plus a share of the layer. CuraEngine has
lost corners of about 2000 mm2."""
TIP_MM = 1.0
"""Height that may be missing at a sharp edge or a tip."""
MAX_EXACT_LAYERS = 24
"""Maximum number of differing layers that are compared as polygons; the others are assumed to be like their
neighbours."""
_PLANE_OFFSET_MM = 0.005  # the engine rounds to 0.001 mm, which tilts nearly flat faces
_NEGLIGIBLE_AREA_MM2 = 0.2


@dataclass(frozen=True, slots=True)
class UnprintedWall:
    """A wall too thin to print.

    Attributes
    ----------
    area_mm2
        Area of the wall, seen from its side.
    from_z_mm, to_z_mm
        Heights between which it stands.
    x_mm, y_mm
        Middle of the wall, from the bed's centre.
    """

    area_mm2: float
    from_z_mm: float
    to_z_mm: float
    x_mm: float
    y_mm: float

    def __str__(self) -> str:
        return (
            f"walls too thin to print: {self.area_mm2:.0f} mm2 at X{self.x_mm:.0f} Y{self.y_mm:.0f}, "
            f"Z {self.from_z_mm:.1f}..{self.to_z_mm:.1f} mm"
        )


def check_outline(
    toolpath: Toolpath,
    corners: Floats,
    layout: WallLayout,
    *,
    removed_layer_count: int,
    centre_mm: tuple[float, float],
    filament_mm2: float,
) -> tuple[UnprintedWall, ...]:
    """Compare each layer's outline with the model's section; return walls too thin to print, largest first.

    Parameters
    ----------
    toolpath
        The G-code.
    corners
        (n, 3 corners, xyz) The mesh that was sliced, in mm from the bed's centre.
    layout
        Position of the outer wall in the model.
    removed_layer_count
        Number of empty layers that the engine removed at the bottom, lowering the others to the bed.
    centre_mm
        The bed's centre in the printer's coordinates.
    filament_mm2
        The filament's cross-section.

    Raises
    ------
    SliceRejected
        `OUTLINE` if something thick enough to print is missing, something is printed outside the model, or
        most of the model is too thin.
    """
    if removed_layer_count:  # the expansion of the first layer was lost with the removed layers
        layout = replace(layout, offset_0_mm=layout.offset_mm)
    if np.linalg.det(corners).sum() < 0:  # an inverted mesh, which the engine accepts
        corners = corners[:, ::-1]
    walls = Walls.from_toolpath(toolpath, layout, centre_mm, filament_mm2)
    z_mm = _find_cut_heights_mm(corners, walls, layout, removed_layer_count)
    differing_layers, difference_mm2 = _find_differing_layers(corners, z_mm, walls, layout)
    if not len(differing_layers):
        return ()
    sampled_layers = _sample_layers(differing_layers, difference_mm2)
    sections = _Sections(corners, layout)
    thin_pieces = [
        piece
        for layer in sampled_layers
        for piece in _compare_layer(int(layer), z_mm, walls, sections, layout)
    ]
    return _join_pieces(thin_pieces, layout, len(differing_layers) / len(sampled_layers))


def _find_cut_heights_mm(
    corners: Floats, walls: Walls, layout: WallLayout, removed_layer_count: int
) -> Floats:
    """Compute the heights (layers,) at which the engine cut the model for the layers that it printed."""
    height_mm = float(corners[..., 2].max())
    planned_count = int((height_mm - layout.layer_height_0_mm) / layout.layer_height_mm + 0.5) + 1
    layer_count = max(1, planned_count - removed_layer_count, int(walls.layer.max(initial=-1)) + 1)
    return layout.compute_section_heights_mm(layer_count + removed_layer_count)[removed_layer_count:]


def _find_differing_layers(
    corners: Floats, z_mm: Floats, walls: Walls, layout: WallLayout
) -> tuple[npt.NDArray[np.intp], Floats]:
    """Find the layers (k,) whose area or centroid differs, and the difference of each area in mm2."""
    layer_count = len(z_mm)
    model_rings = _expand_sections(measure_rings(cut_sections(corners, z_mm), layer_count), layout)
    printed_rings = walls.sum_rings(layer_count)
    _check_areas(model_rings, printed_rings, walls, layout)
    difference_mm2 = np.abs(printed_rings.area_mm2 - model_rings.area_mm2)
    max_difference_mm2 = SLACK_MM2 + (SLACK_MM + layout.slack_mm) * model_rings.length_mm
    moment_difference_mm3 = np.abs(printed_rings.moment_mm3 - model_rings.moment_mm3).max(axis=1)
    lever_mm = np.abs(corners[..., :2]).max() + TIP_MM  # maximum distance of a difference from an axis
    differing_layers = np.flatnonzero(
        (difference_mm2 > max_difference_mm2)
        | (moment_difference_mm3 > max_difference_mm2 * lever_mm + TOLERANCE_MM * model_rings.area_mm2)
    )
    return differing_layers, difference_mm2[differing_layers]


def _check_areas(model_rings: Rings, printed_rings: Rings, walls: Walls, layout: WallLayout) -> None:
    """Reject a slice that lacks most of the model, or in which inner walls have lost a corner."""
    share = printed_rings.area_mm2.sum() / max(model_rings.area_mm2.sum(), _NEGLIGIBLE_AREA_MM2)
    if share < 0.5:
        raise SliceRejected(
            Rule.OUTLINE,
            f"{100 - 100 * share:.0f} % of the model is missing: its walls are too thin to print, or its "
            "mesh is broken; thicken the walls, scale the model up, use a smaller nozzle, or repair the mesh",
        )
    missing_mm2 = walls.compute_missing_areas_mm2(layout, len(model_rings.area_mm2))
    incomplete_layers = np.flatnonzero(missing_mm2 > MAX_LOST_MM2 + MAX_LOST_SHARE * model_rings.area_mm2)
    if len(incomplete_layers):
        layer = int(incomplete_layers[0])
        raise SliceRejected(
            Rule.OUTLINE,
            f"layer {layer} (Z {layout.compute_top_mm(layer):.2f} mm) lacks {missing_mm2[layer]:.0f} mm2 "
            "within its inner walls; repair the mesh, or scale it by a factor of 1.001",
        )


def _expand_sections(model_rings: Rings, layout: WallLayout) -> Rings:
    """Expand sections by the engine's horizontal expansion, to first order."""
    offset_mm = np.full(len(model_rings.area_mm2), layout.offset_mm)
    offset_mm[:1] = layout.offset_0_mm
    return Rings(
        model_rings.area_mm2 + offset_mm * model_rings.length_mm,
        model_rings.length_mm,
        model_rings.moment_mm3,
    )


def _sample_layers(layers: npt.NDArray[np.intp], difference_mm2: Floats) -> npt.NDArray[np.intp]:
    """Choose at most `MAX_EXACT_LAYERS` of the layers: the worst, and others in even steps."""
    if len(layers) <= MAX_EXACT_LAYERS:
        return layers
    worst_layers = layers[np.argsort(difference_mm2)[-MAX_EXACT_LAYERS // 4 :]]
    evenly_spaced = layers[np.linspace(0, len(layers) - 1, MAX_EXACT_LAYERS - len(worst_layers)).astype(int)]
    return np.unique(np.concatenate((worst_layers, evenly_spaced)))


class _Sections:
    """Sections of the model as polygons."""

    def __init__(self, corners: Floats, layout: WallLayout) -> None:
        self._corners = corners
        self._layout = layout

    def cut_section(self, z_mm: float, layer: int) -> Geometry:
        """Build the area with a positive winding number at a height, expanded as for `layer`."""
        pieces = list(cut_sections(self._corners, np.array([z_mm])))
        if not pieces:
            return shapely.Polygon()
        start = np.concatenate([piece[1] for piece in pieces])
        end = np.concatenate([piece[2] for piece in pieces])
        has_length = (start != end).any(axis=1)
        start, end = start[has_length], end[has_length]
        noded_lines = shapely.union_all(shapely.linestrings(np.stack((start, end), axis=1)))
        faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(noded_lines)))
        points = shapely.get_coordinates(shapely.point_on_surface(faces))
        solid = [
            face for face, (x, y) in zip(faces, points, strict=True) if _compute_winding(start, end, x, y) > 0
        ]
        offset_mm = self._layout.offset_0_mm if layer == 0 else self._layout.offset_mm
        return shapely.union_all(solid).buffer(offset_mm, join_style="mitre")


def _compute_winding(start: Floats, end: Floats, x: float, y: float) -> int:
    """Compute the winding number of segments about a point, counter-clockwise."""
    rises = (start[:, 1] <= y) & (end[:, 1] > y)
    falls = (start[:, 1] > y) & (end[:, 1] <= y)
    direction = end - start
    is_left = direction[:, 0] * (y - start[:, 1]) - (x - start[:, 0]) * direction[:, 1] > 0
    return int((rises & is_left).sum() - (falls & ~is_left).sum())


def _compare_layer(
    layer: int, z_mm: Floats, walls: Walls, sections: _Sections, layout: WallLayout
) -> list[tuple[int, Geometry]]:
    """Find the thin pieces that are missing in a layer, each with `layer`; reject any other difference."""
    adjacent_sections = [
        sections.cut_section(float(z_mm[layer]) + offset_mm, layer)
        for offset_mm in (-_PLANE_OFFSET_MM, _PLANE_OFFSET_MM)
    ]
    printed = walls.build_printed_area(layer, shapely.union_all(adjacent_sections))
    tolerance_mm = TOLERANCE_MM + layout.slack_mm
    extra_area = _find_largest_piece(
        printed.difference(shapely.union_all(adjacent_sections).buffer(tolerance_mm))
    )
    layer_text = f"layer {layer} (Z {layout.compute_top_mm(layer):.2f} mm)"
    if extra_area is not None:
        raise SliceRejected(
            Rule.OUTLINE,
            f"{layer_text} prints {extra_area.area:.1f} mm2 outside the model at "
            f"{_format_place(extra_area)}; repair the mesh",
        )
    certain_area = adjacent_sections[0].intersection(adjacent_sections[1])
    missing_area = certain_area.difference(printed.buffer(tolerance_mm))
    if missing_area.area > _NEGLIGIBLE_AREA_MM2:
        missing_area = missing_area.difference(
            walls.build_filling(layer, missing_area.bounds).buffer(tolerance_mm)
        )
    opening_radius_mm = float(layout.compute_reach_mm(np.array([layer], np.int32))[0]) + 0.03
    thick_area = certain_area.buffer(-opening_radius_mm).buffer(opening_radius_mm)
    lost_area = _find_largest_piece(missing_area.intersection(thick_area))
    if lost_area is not None:
        raise SliceRejected(
            Rule.OUTLINE,
            f"{layer_text} leaves out {lost_area.area:.1f} mm2 of the model at {_format_place(lost_area)}; "
            "repair the mesh there",
        )
    printed_surroundings = printed.buffer(TIP_MM)
    return [
        (layer, piece)
        for piece in shapely.get_parts(missing_area.difference(thick_area))
        if piece.area > _NEGLIGIBLE_AREA_MM2 and not printed_surroundings.covers(piece)
    ]


def _find_largest_piece(shape: Geometry) -> Geometry | None:
    """Find the largest piece that is more than a sliver; None if there is none."""
    core = shape.buffer(-TOLERANCE_MM / 2).buffer(TOLERANCE_MM / 2)
    pieces = [piece for piece in shapely.get_parts(core) if piece.area > MIN_REJECTED_MM2]
    return max(pieces, key=lambda piece: float(piece.area), default=None)


def _format_place(shape: Geometry) -> str:
    """Format the coordinates of a point in a shape."""
    middle = shape.representative_point()
    return f"X{middle.x:.1f} Y{middle.y:.1f} (from the bed's centre)"


def _join_pieces(
    pieces: list[tuple[int, Geometry]], layout: WallLayout, layers_per_sample: float
) -> tuple[UnprintedWall, ...]:
    """Join pieces above one another into walls, the largest first."""
    if not pieces:
        return ()
    shapes = np.array([piece for _, piece in pieces])
    footprints = shapely.get_parts(shapely.union_all(shapely.buffer(shapes, TIP_MM)))
    walls = []
    for footprint in footprints:
        wall_pieces = [(layer, piece) for layer, piece in pieces if footprint.intersects(piece)]
        layers = [layer for layer, _ in wall_pieces]
        x0_mm, y0_mm, x1_mm, y1_mm = footprint.bounds
        low_mm, high_mm = (
            layout.compute_top_mm(min(layers) - 1) if min(layers) else 0.0,
            layout.compute_top_mm(max(layers)),
        )
        side_mm2 = (
            sum(piece.length / 2 for _, piece in wall_pieces) * layout.layer_height_mm * layers_per_sample
        )
        if high_mm - low_mm < TIP_MM or side_mm2 < MIN_WALL_MM2:
            continue
        middle_mm = ((x0_mm + x1_mm) / 2, (y0_mm + y1_mm) / 2)
        walls.append(UnprintedWall(float(side_mm2), low_mm, high_mm, *middle_mm))
    return tuple(sorted(walls, key=lambda wall: -wall.area_mm2))
