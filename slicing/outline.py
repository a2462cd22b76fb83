"""Each layer's printed outline against the mesh's section: what CuraEngine left out, and what it made up.

Two steps. The areas and first moments of all sections and of all printed outlines are compared in one go, by
Green's theorem over segments. Only where a layer differs are polygons made of it, which tell where, and
whether what is missing is thinner than two lines can be: that is reported, anything else is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from shapely import Geometry

from slicing.errors import Rule, SliceRejected
from slicing.section import Floats, Rings, cut, measure
from slicing.settings import Settings
from slicing.toolpath import Toolpath

TOLERANCE_MM = 0.15
"""How far an outline may be off: the engine simplifies it (0.05 mm), and a section on a slope is rounded."""
SLACK_MM2, SLACK_MM = 0.5, 0.005
"""What the area of a layer may be off by before its polygons are compared: so much, and so much for each mm
of outline. Sound models stay within it in nearly all layers."""
WALL_MM2 = 5.0
"""The smallest wall that is worth a word."""
GRAVE_MM2 = 1.0
"""The smallest piece that is worth a refusal."""
TIP_MM = 1.0
"""A sharp edge or a tip may end this much early."""
EXACT_LAYERS = 24
"""How many of the layers that differ are looked at; the others count as those between them."""
_PLANE_MM = 0.005  # the engine rounds to 0.001 mm, which tilts what is nearly flat
_SPECK_MM2 = 0.2
_GAPS = 8  # in one ring
_FOLLOWING = {
    "adaptive_layer_height_enabled": "False",
    "conical_overhang_enabled": "False",
    "magic_fuzzy_skin_enabled": "False",
    "magic_mesh_surface_mode": "normal",
    "magic_spiralize": "False",
    "mold_enabled": "False",
    "slicing_tolerance": "middle",
}  # with anything else the outer wall leaves the model's outline


@dataclass(frozen=True, slots=True)
class Unprinted:
    """A wall too thin to print.

    Attributes
    ----------
    area_mm2
        Of the wall, seen from its side.
    from_z_mm, to_z_mm
        Between which heights.
    x_mm, y_mm
        Its middle, from the bed's centre.
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


@dataclass(frozen=True, slots=True)
class Lines:
    """How the outer wall lies in the model, in mm."""

    layer_height_0_mm: float
    layer_height_mm: float
    width_mm: float
    factor_0: float  # the first layer's width over the others'
    inset_mm: float
    offset_0_mm: float  # how far the model is grown in the first layer
    offset_mm: float
    slack_mm: float

    def reach_mm(self, layer: npt.NDArray[np.int32]) -> Floats:
        """(n,) From a ring's middle to the model's outline."""
        return np.where(layer == 0, self.factor_0, 1.0) * self.width_mm / 2 + self.inset_mm

    def section_mm(self, count: int) -> Floats:
        """(n,) Where the engine cuts the model: through the middle of each layer."""
        above = self.layer_height_0_mm + self.layer_height_mm * (np.arange(1, count) - 0.5)
        return np.concatenate(([self.layer_height_0_mm / 2], above))[:count]

    def top_mm(self, layer: int) -> float:
        return self.layer_height_0_mm + layer * self.layer_height_mm


def lines_of(settings: Settings) -> Lines | None:
    """What the settings say of the outer wall; None where they do not follow the model's outline."""
    scopes = (settings.extruder, settings.global_)

    def number(key: str) -> float:
        return float(settings.extruder.get(key) or settings.global_.get(key) or 0.0)

    if settings.wall_count < 1 or any(
        scope.get(key, kept) != kept for scope in scopes for key, kept in _FOLLOWING.items()
    ):
        return None
    return Lines(
        layer_height_0_mm=settings.layer_height_0_mm,
        layer_height_mm=settings.layer_height_mm,
        width_mm=settings.line_width_0_mm,
        factor_0=number("initial_layer_line_width_factor") / 100 or 1.0,
        inset_mm=number("wall_0_inset"),
        offset_0_mm=number("xy_offset_layer_0"),
        offset_mm=number("xy_offset"),
        slack_mm=abs(number("hole_xy_offset")),
    )


def check_outline(
    path: Toolpath,
    corners: Floats,
    lines: Lines,
    *,
    removed: int,
    centre_mm: tuple[float, float],
    filament_mm2: float,
) -> tuple[Unprinted, ...]:
    """Compare all layers; what is too thin to print, the largest first.

    Parameters
    ----------
    path
        The G-code.
    corners
        (n, 3 corners, xyz) The mesh that was sliced, in mm from the bed's centre.
    removed
        How many layers the engine took away below the first that is not empty; it put the others down.
    centre_mm
        The bed's centre in the printer's coordinates.
    filament_mm2
        The filament's cross-section.

    Raises
    ------
    SliceRejected
        `OUTLINE` where something thick enough is missing, something is printed outside of the model, or most
        of the model is too thin.
    """
    if removed:  # what is printed first is not the layer that was grown as the first
        lines = replace(lines, offset_0_mm=lines.offset_mm)
    walls = _Walls.of(path, lines, centre_mm, filament_mm2)
    height_mm = float(corners[..., 2].max())
    count = max(
        int((height_mm - lines.layer_height_0_mm) / lines.layer_height_mm + 0.5) + 1 - removed,
        int(walls.layer.max(initial=-1)) + 1,
    )
    z_mm = lines.section_mm(count + removed)[removed:]
    model = _grown(measure(cut(corners, z_mm), count), lines)
    printed = walls.rings(count)
    off_mm2 = printed.area_mm2 - model.area_mm2
    share = printed.area_mm2.sum() / model.area_mm2.sum()
    if share < 0.5:
        raise SliceRejected(
            Rule.OUTLINE,
            f"{100 - 100 * share:.0f} % of the model is missing: its walls are too thin to print, or its "
            "mesh is broken; thicken them, scale it up, take a finer nozzle, or repair it",
        )
    slack_mm2 = SLACK_MM2 + (SLACK_MM + lines.slack_mm) * model.length_mm
    away_mm3 = np.abs(printed.moment_mm3 - model.moment_mm3).max(axis=1)
    reach_mm = np.abs(corners[..., :2]).max() + TIP_MM
    differ = np.abs(off_mm2) > slack_mm2
    differ |= away_mm3 > slack_mm2 * reach_mm + TOLERANCE_MM * model.area_mm2
    found = np.flatnonzero(differ)
    if not len(found):
        return ()
    looked = _sample(found, np.abs(off_mm2[found]))
    sections = _Sections(corners, lines)
    thin = [piece for layer in looked for piece in _compare(int(layer), z_mm, walls, sections, lines)]
    return _gathered(thin, lines, len(found) / len(looked))


def _grown(model: Rings, lines: Lines) -> Rings:
    """The sections after the engine's horizontal expansion, to first order."""
    offset = np.full(len(model.area_mm2), lines.offset_mm)
    offset[:1] = lines.offset_0_mm
    return Rings(model.area_mm2 + offset * model.length_mm, model.length_mm, model.moment_mm3)


def _sample(found: npt.NDArray[np.intp], off_mm2: Floats) -> npt.NDArray[np.intp]:
    """At most `EXACT_LAYERS` of them: the worst, and others in even steps."""
    if len(found) <= EXACT_LAYERS:
        return found
    worst = found[np.argsort(off_mm2)[-EXACT_LAYERS // 4 :]]
    even = found[np.linspace(0, len(found) - 1, EXACT_LAYERS - len(worst)).astype(int)]
    return np.unique(np.concatenate((worst, even)))


@dataclass(frozen=True, slots=True)
class _Walls:
    """The printed lines of the outer wall: (n,) one for each move, in mm from the bed's centre."""

    start: Floats  # (n, 2)
    end: Floats  # (n, 2)
    layer: npt.NDArray[np.int32]
    run: npt.NDArray[np.intp]  # which unbroken line it belongs to
    closed: npt.NDArray[np.bool_]  # whether that line is a ring
    width_mm: Floats  # by the filament that was pushed
    half_mm: Floats  # of the line's width; of a ring: from its middle to the model's outline
    others: Floats  # (m, 6) all other lines of the part: start, end, layer, half width

    @classmethod
    def of(cls, path: Toolpath, lines: Lines, centre_mm: tuple[float, float], filament_mm2: float) -> _Walls:
        pushed_mm = path.pushed_mm
        way_mm = np.hypot(*(path.after[:, :2] - path.before[:, :2]).T)
        prints = (pushed_mm > 0) & (way_mm > 0) & (path.layer >= 0)
        height_mm = np.where(path.layer == 0, lines.layer_height_0_mm, lines.layer_height_mm)
        half_mm = np.zeros(len(way_mm))
        half_mm[prints] = (pushed_mm * filament_mm2)[prints] / (way_mm * height_mm)[prints] / 2
        half_mm = np.minimum(half_mm, lines.width_mm)  # more is a blob, and covers nothing
        at = np.flatnonzero(prints & path.is_feature("WALL-OUTER"))
        start, end = path.before[at, :2] - centre_mm, path.after[at, :2] - centre_mm
        layer = path.layer[at]
        bridges, run, closed = _runs(start, end, layer)
        order = np.argsort(np.concatenate((np.arange(len(at)), bridges)), kind="stable")

        def bridged(own: npt.NDArray[Any], between: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.asarray(np.concatenate((own, between))[order])

        start, end = bridged(start, end[bridges]), bridged(end, np.roll(start, -1, axis=0)[bridges])
        half = bridged(half_mm[at], half_mm[at][bridges])
        layer, run = bridged(layer, layer[bridges]), bridged(run, run[bridges])
        closed = closed[run]
        own = np.zeros(len(way_mm), bool)
        for name in ("WALL-INNER", "SKIN", "FILL"):
            own |= path.is_feature(name)
        own &= prints
        ends = (path.before[own, :2] - centre_mm, path.after[own, :2] - centre_mm)
        others = np.column_stack((*ends, path.layer[own], half_mm[own])).astype(np.float64)
        reach_mm = np.where(closed, lines.reach_mm(layer), half)
        return cls(start, end, layer, run, closed, 2 * half, reach_mm, others)

    def rings(self, count: int) -> Rings:
        """What is inside of the outer edge of the outer wall, to first order, at each layer."""
        ring = self.closed
        inside = measure(iter([(self.layer[ring].astype(np.intp), self.start[ring], self.end[ring])]), count)
        # An engine may go round the other way; all rings of a layer then do.
        turn = np.where(inside.area_mm2 < 0, -1.0, 1.0)
        band_mm2 = np.hypot(*(self.end - self.start).T) * self.half_mm * np.where(ring, 1.0, 2.0)
        corners_mm2 = np.bincount(self.layer, self._corners_mm2(), count)
        area = turn * (inside.area_mm2 + corners_mm2) + np.bincount(self.layer, band_mm2, count)
        moment = turn[:, None] * inside.moment_mm3
        for axis in range(2):
            middle = (self.start[:, axis] + self.end[:, axis]) / 2
            moment[:, axis] += np.bincount(self.layer, band_mm2 * middle, count)
        return Rings(area, inside.length_mm, moment)

    def _corners_mm2(self) -> Floats:
        """(n,) What the band outside of a ring has more at the corner after a move than along the moves."""
        if not len(self.run):
            return np.empty(0)
        following = np.arange(1, len(self.run) + 1)
        heads = np.flatnonzero(np.diff(self.run, prepend=-1))
        following[np.append(heads[1:], len(self.run)) - 1] = heads
        way = self.end - self.start
        after = way[following]
        cross = way[:, 0] * after[:, 1] - way[:, 1] * after[:, 0]
        scale = np.hypot(*way.T) * np.hypot(*after.T) + (way * after).sum(axis=1)
        half_turn = np.clip(cross / np.maximum(scale, 1e-9), -2.0, 2.0)  # tangent of half the angle
        return np.where(self.closed, self.half_mm**2 * half_turn, 0.0)

    def printed(self, layer: int, model: Geometry) -> Geometry:
        """The area inside of the outer edge of the outer wall.

        A ring is the edge of an area, or by itself a wall of one line: that has the model on neither side.
        """
        here = np.flatnonzero(self.layer == layer)
        line = ~self.closed[here]
        inside: Geometry = shapely.Polygon()
        for run in np.unique(self.run[here][~line]):
            of_run = self.run[here] == run
            points = np.vstack((self.start[here[of_run][:1]], self.end[here[of_run]]))
            if self._alone(here[of_run], model):
                line |= of_run
            elif len(points) > 3:
                # Rings do not cross each other: one within another is a hole.
                inside = inside.symmetric_difference(shapely.make_valid(shapely.Polygon(points)))
        reach_mm = float(self.half_mm[here][~line].max(initial=0.0))
        strokes = _strokes(self.start[here[line]], self.end[here[line]], self.width_mm[here[line]] / 2)
        return shapely.union_all([inside.buffer(reach_mm, join_style="mitre"), strokes])

    def _alone(self, ring: npt.NDArray[np.intp], model: Geometry) -> bool:
        """Whether there is nothing of the model beside a line."""
        way = self.end[ring] - self.start[ring]
        aside = np.column_stack((-way[:, 1], way[:, 0])) / np.hypot(*way.T)[:, None]
        aside *= (self.width_mm[ring] / 2 + TOLERANCE_MM)[:, None]
        middle = (self.start[ring] + self.end[ring]) / 2
        beside = [shapely.contains_xy(model, *(middle + side * aside).T) for side in (-1.0, 1.0)]
        return float(np.mean(beside[0] | beside[1])) < 0.5

    def filling(self, layer: int, bounds: tuple[float, float, float, float]) -> Geometry:
        """The area of the other lines of the part that come near a rectangle."""
        rows = self.others[self.others[:, 4] == layer]
        low, high = (
            np.minimum(rows[:, :2], rows[:, 2:4]) - TIP_MM,
            np.maximum(rows[:, :2], rows[:, 2:4]) + TIP_MM,
        )
        near = (low[:, 0] < bounds[2]) & (low[:, 1] < bounds[3])
        rows = rows[near & (high[:, 0] > bounds[0]) & (high[:, 1] > bounds[1])]
        return _strokes(rows[:, :2], rows[:, 2:4], rows[:, 5])


def _runs(
    start: Floats, end: Floats, layer: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Which moves make one unbroken line, and which lines are rings.

    Where two walls overlap, an engine leaves out the flow of a move or two: a line that does not close is
    joined over such gaps to those that follow, if it closes then.

    Returns
    -------
    tuple
        The moves after which a gap is bridged; (n,) the line of each move; whether each line is a ring.
    """
    if not len(start):
        return np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0, bool)
    first = np.ones(len(start), bool)
    first[1:] = (start[1:] != end[:-1]).any(axis=1) | (layer[1:] != layer[:-1])
    begins = np.flatnonzero(first)
    ends = np.append(begins[1:], len(start)) - 1
    near = np.hypot(*(start[begins] - end[ends]).T) < TOLERANCE_MM
    bridges: list[int] = []
    at = 0
    while at < len(begins):
        stop = at + 1
        if not near[at]:
            for last in range(at + 1, min(at + _GAPS, len(begins))):
                if near[last] or layer[begins[last]] != layer[begins[at]]:
                    break
                if np.hypot(*(start[begins[at]] - end[ends[last]])) < TOLERANCE_MM:
                    bridges += [int(move) for move in ends[at:last]]
                    stop = last + 1
                    break
        at = stop
    joined = first.copy()
    joined[np.array(bridges, np.intp) + 1] = False
    run = np.cumsum(joined) - 1
    heads = np.flatnonzero(joined)
    tails = np.append(heads[1:], len(start)) - 1
    closed = np.hypot(*(start[heads] - end[tails]).T) < TOLERANCE_MM
    return np.array(bridges, np.intp), run, closed


def _strokes(start: Floats, end: Floats, half_mm: Floats) -> Geometry:
    lines = shapely.linestrings(np.stack((start, end), axis=1))
    return shapely.union_all(shapely.buffer(lines, half_mm))


class _Sections:
    """The model's sections as polygons."""

    def __init__(self, corners: Floats, lines: Lines) -> None:
        self._corners = corners
        self._lines = lines

    def at(self, z_mm: float, layer: int) -> Geometry:
        """Where the winding number is positive: bodies that overlap are one."""
        pieces = list(cut(self._corners, np.array([z_mm])))
        if not pieces:
            return shapely.Polygon()
        start = np.concatenate([piece[1] for piece in pieces])
        end = np.concatenate([piece[2] for piece in pieces])
        long = (start != end).any(axis=1)
        start, end = start[long], end[long]
        net = shapely.union_all(shapely.linestrings(np.stack((start, end), axis=1)))
        faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(net)))
        points = shapely.get_coordinates(shapely.point_on_surface(faces))
        solid = [face for face, (x, y) in zip(faces, points, strict=True) if _winding(start, end, x, y) > 0]
        offset = self._lines.offset_0_mm if layer == 0 else self._lines.offset_mm
        return shapely.union_all(solid).buffer(offset, join_style="mitre")


def _winding(start: Floats, end: Floats, x: float, y: float) -> int:
    """How often the segments go round a point, counter-clockwise."""
    rises = (start[:, 1] <= y) & (end[:, 1] > y)
    falls = (start[:, 1] > y) & (end[:, 1] <= y)
    way = end - start
    left = way[:, 0] * (y - start[:, 1]) - (x - start[:, 0]) * way[:, 1] > 0
    return int((rises & left).sum() - (falls & ~left).sum())


def _compare(
    layer: int, z_mm: Floats, walls: _Walls, sections: _Sections, lines: Lines
) -> list[tuple[int, Geometry]]:
    """The thin pieces that are missing in a layer, each with the layer; refuses anything else."""
    near = [sections.at(float(z_mm[layer]) + side, layer) for side in (-_PLANE_MM, _PLANE_MM)]
    printed = walls.printed(layer, shapely.union_all(near))
    tolerance_mm = TOLERANCE_MM + lines.slack_mm
    extra = _worst(printed.difference(shapely.union_all(near).buffer(tolerance_mm)))
    where = f"layer {layer} (Z {lines.top_mm(layer):.2f} mm)"
    if extra is not None:
        raise SliceRejected(
            Rule.OUTLINE,
            f"{where} prints {extra.area:.1f} mm2 outside of the model at {_at(extra)}; repair the mesh",
        )
    sure = near[0].intersection(near[1])
    missing = sure.difference(printed.buffer(tolerance_mm))
    if missing.area > _SPECK_MM2:
        missing = missing.difference(walls.filling(layer, missing.bounds).buffer(tolerance_mm))
    two_lines_mm = float(lines.reach_mm(np.array([layer], np.int32))[0]) + 0.03
    thick = sure.buffer(-two_lines_mm).buffer(two_lines_mm)
    gone = _worst(missing.intersection(thick))
    if gone is not None:
        raise SliceRejected(
            Rule.OUTLINE,
            f"{where} leaves out {gone.area:.1f} mm2 of the model at {_at(gone)}; repair the mesh there",
        )
    beyond = printed.buffer(TIP_MM)
    return [
        (layer, piece)
        for piece in shapely.get_parts(missing.difference(thick))
        if piece.area > _SPECK_MM2 and not beyond.covers(piece)
    ]


def _worst(shape: Geometry) -> Geometry | None:
    """The largest piece that is more than a sliver; None where there is none worth a refusal."""
    core = shape.buffer(-TOLERANCE_MM / 2).buffer(TOLERANCE_MM / 2)
    pieces = [piece for piece in shapely.get_parts(core) if piece.area > GRAVE_MM2]
    return max(pieces, key=lambda piece: float(piece.area), default=None)


def _at(shape: Geometry) -> str:
    middle = shape.representative_point()
    return f"X{middle.x:.1f} Y{middle.y:.1f} (from the bed's centre)"


def _gathered(pieces: list[tuple[int, Geometry]], lines: Lines, share: float) -> tuple[Unprinted, ...]:
    """Pieces above one another as one wall, the largest first."""
    if not pieces:
        return ()
    shapes = np.array([piece for _, piece in pieces])
    ground = shapely.get_parts(shapely.union_all(shapely.buffer(shapes, TIP_MM)))
    walls = []
    for shadow in ground:
        of = [(layer, piece) for layer, piece in pieces if shadow.intersects(piece)]
        layers = [layer for layer, _ in of]
        box = shadow.bounds
        low_mm, high_mm = lines.top_mm(min(layers) - 1) if min(layers) else 0.0, lines.top_mm(max(layers))
        side_mm2 = sum(piece.length / 2 for _, piece in of) * lines.layer_height_mm * share
        if high_mm - low_mm < TIP_MM or side_mm2 < WALL_MM2:
            continue
        middle = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        walls.append(Unprinted(float(side_mm2), low_mm, high_mm, *middle))
    return tuple(sorted(walls, key=lambda wall: -wall.area_mm2))
