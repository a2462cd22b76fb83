"""Slicing of one plate: an STL in its printing pose becomes a checked G-code file, or an error.

Request and result are plain data, so that slicing can run in worker processes.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from slicing.checks import (
    FeatureTimes,
    MotionLimits,
    Toolpath,
    UnprintedWall,
    add_times,
    check_outline,
    measure_feature_times,
    output,
    read_toolpath,
    read_wall_layout,
    remove_reset_times,
)
from slicing.engine import EngineLimits, EngineOutput, ProgressCallback, check_versions, run_engine
from slicing.errors import Rule, SliceRejected, SlicingError
from slicing.glued_parts import (
    HiddenRecess,
    HiddenSide,
    remove_inner_walls,
    remove_recess_skins,
    reorder_infill,
    reorder_inner_walls,
    reorder_outlines,
    speed_up_hidden_walls,
)
from slicing.layer_scale import LayerScale
from slicing.mesh import Floats, add_waves, read_triangles, write_triangles
from slicing.settings import EngineSettings
from slicing.slice_store import CheckedSlice, StoredSlice, write_atomically

_BED_TOLERANCE_MM = 0.02
_RETRIES = ((0.0, 0.0), (1e-4, 0.005), (-3e-4, -0.02), (5e-4, -0.03))
"""Shares by which a part is scaled, and mm by which its outlines are expanded, in the order of the attempts.

CuraEngine 4.13 loses a corner of a valid ring where the product of the corner's two sides is 2**32 um2
(measured: from 0.99995 to 1.000003 of it), both in a layer's section and in its walls."""
_RETRIED_RULES = frozenset((Rule.NOTHING_PRINTED, Rule.LAYERS, Rule.HEIGHT, Rule.OUTLINE))


@dataclass(frozen=True, slots=True)
class PlateRequest:
    """Model to slice, its settings, and the bed that must hold it.

    Attributes
    ----------
    stl
        Binary STL in its printing pose, in bed-centred mm (XY 0 is the bed's centre), lowest point at Z 0.
    output_path
        File of the G-code; written atomically.
    bed
        Rectangles (min_x, min_y, max_x, max_y, height) in bed-centred mm; one of them must hold all
        extrusion, including brim and support.
    cache
        Folder that keeps results by content; None to cache nothing.
    hidden_sides
        Upright sides of the model that are hidden once the parts are glued.
    hidden_recesses
        Recesses in its level faces that are hidden as well.
    """

    stl: Path
    settings: EngineSettings
    output_path: Path
    engine: Path
    bed: output.Bed
    timeout_s: float = 1800.0
    cache: Path | None = None
    hidden_sides: tuple[HiddenSide, ...] = ()
    hidden_recesses: tuple[HiddenRecess, ...] = ()


@dataclass(frozen=True, slots=True)
class PlateResult:
    """G-code file that may be printed; `sliced_s` is its time without heating, homing and priming."""

    gcode: Path
    sha256: str
    sliced_s: float
    filament_mm: float
    filament_mm3: float
    grams: float
    layers: int
    height_mm: float
    min_mm: tuple[float, float, float]  # of all extrusion, from the bed's centre
    max_mm: tuple[float, float, float]
    is_cached: bool
    features: FeatureTimes  # of `sliced_s`
    unprinted_walls: tuple[UnprintedWall, ...] = ()  # walls too thin to print, the largest first


def slice_plate(request: PlateRequest, progress: ProgressCallback | None = None) -> PlateResult:
    """Slice one plate and check the result, or read it from the cache if the same plate was sliced before.

    Parameters
    ----------
    request
        Model, settings and bed.
    progress
        Function that is called from time to time with the completed share of the engine's work, 0 to 1.

    Raises
    ------
    SliceRejected
        If the mesh or the G-code breaks a rule.
    EngineMissing, EngineFailed, EngineTimeout
        If CuraEngine cannot be run, fails, or takes too long.
    SlicingError
        If a file cannot be read or written.
    """
    try:
        model = request.stl.read_bytes()
        corners = read_triangles(model)
        lowest_mm = float(corners[..., 2].min())
        if abs(lowest_mm) > _BED_TOLERANCE_MM:
            raise SliceRejected(Rule.HEIGHT, f"the model starts at Z {lowest_mm:.2f} mm; put it on the bed")
        entry = StoredSlice.locate(
            request.cache,
            request.engine,
            request.settings,
            model,
            request.hidden_sides,
            request.hidden_recesses,
        )
        stored_slice = entry.read()
        sliced = stored_slice or _slice_with_retries(request, corners, progress)
        if stored_slice is None:
            entry.write(sliced)
        # The bed is not part of the cache's key, because the same file may fit one printer but not another.
        _check_bed(request, sliced.facts)
        write_atomically(request.output_path, sliced.gcode)
    except OSError as error:
        raise SlicingError(
            f"{error.filename or request.output_path}: {error.strerror}; free space there, or check its "
            "permissions"
        ) from error
    return _build_result(request, sliced, stored_slice is not None)


def _slice_with_retries(
    request: PlateRequest, corners: Floats, progress: ProgressCallback | None
) -> CheckedSlice:
    """Slice the part as it is; if that is rejected, slightly scaled; at last with waves in its sides."""
    check_versions(request.engine, request.settings.extruder)
    first_error: SliceRejected | None = None
    with tempfile.TemporaryDirectory(prefix="farm-retry-") as folder:
        variants = [
            partial(_build_scaled_request, request, corners, share, offset_mm, Path(folder))
            for share, offset_mm in _RETRIES
        ]
        for variant in (*variants, partial(_build_wavy_request, request, corners, Path(folder))):
            try:
                return _slice_once(variant(), corners, progress)
            except SliceRejected as error:
                first_error = first_error or error
                if error.rule not in _RETRIED_RULES:
                    break
    assert first_error is not None
    raise first_error


def _build_scaled_request(
    request: PlateRequest, corners: Floats, share: float, offset_mm: float, folder: Path
) -> PlateRequest:
    """Build the request for a part scaled by a share about the bed's centre, with expanded outlines."""
    if not share:
        return request
    scaled_stl = folder / request.stl.name
    scaled = corners.astype(np.float32)
    scaled[..., :2] *= 1.0 + share
    scaled_stl.write_bytes(write_triangles(scaled))
    settings = request.settings
    offsets = {
        key: str(float(settings.extruder.get(key) or 0.0) + offset_mm)
        for key in ("xy_offset", "xy_offset_layer_0")
    }
    return replace(
        request, stl=scaled_stl, settings=replace(settings, extruder={**settings.extruder, **offsets})
    )


def _build_wavy_request(request: PlateRequest, corners: Floats, folder: Path) -> PlateRequest:
    """Build the request for a part whose long sides have a wave of hundredths of a mm."""
    wavy_stl = folder / request.stl.name
    wavy_stl.write_bytes(write_triangles(add_waves(corners)))
    return replace(request, stl=wavy_stl)


def _slice_once(request: PlateRequest, corners: Floats, progress: ProgressCallback | None) -> CheckedSlice:
    """Slice a part once, and check the result."""
    settings = request.settings
    height_mm = float(corners[..., 2].max())
    layers = math.ceil(height_mm / settings.layer_height_mm) + 1
    limits = EngineLimits(layers, request.timeout_s)
    engine_output = _run_engine(request, limits, progress)
    output.check_log(engine_output.log)
    motion_limits = MotionLimits.from_settings(settings.global_)
    gcode = remove_reset_times(engine_output.gcode, read_toolpath(engine_output.gcode), motion_limits)
    engine_toolpath = read_toolpath(gcode)
    gcode, toolpath = _change_hidden_walls(gcode, engine_toolpath, request)
    min_extrusion_c = settings.printer.limits.min_extrusion_c
    facts = output.gather_facts(toolpath, min_extrusion_c)
    removed_layers, layout = output.count_removed_layers(engine_output.log), read_wall_layout(settings)
    output.check_facts(
        facts,
        height_mm=height_mm,
        removed_mm=removed_layers * settings.layer_height_mm,
        is_top_checked=layout is not None,
        layer_height_mm=max(settings.layer_height_mm, settings.layer_height_0_mm),
        min_extrusion_c=min_extrusion_c,
    )
    output.check_end_retraction(facts, settings.printer.code.park_retraction_mm)
    unprinted_walls: tuple[UnprintedWall, ...] = ()
    if layout is not None:
        # The outer walls stay as the engine has printed them; its inner walls are checked as well.
        unprinted_walls = check_outline(
            engine_toolpath,
            corners,
            layout,
            removed_layer_count=removed_layers,
            centre_mm=_find_bed_centre(settings),
            filament_mm2=settings.filament_mm2,
        )
    return CheckedSlice(
        output.replace_header(
            add_times(gcode, toolpath),
            engine_output.log,
            facts.sliced_s,
            filament_mm=facts.filament_mm,
            height_mm=facts.max_mm[2],
        ),
        facts,
        unprinted_walls,
        measure_feature_times(toolpath, motion_limits),
    )


def _run_engine(
    request: PlateRequest, limits: EngineLimits, progress: ProgressCallback | None
) -> EngineOutput:
    """Run the engine, in its scale of heights if it has to round the layers."""
    settings, scale = request.settings, LayerScale.from_settings(request.settings)
    if scale is None:
        return run_engine(request.engine, request.stl, settings.global_, settings.extruder, limits, progress)
    with tempfile.TemporaryDirectory(prefix="farm-scaled-") as folder:
        stl = Path(folder) / request.stl.name
        stl.write_bytes(write_triangles(scale.scale_model(read_triangles(request.stl.read_bytes()))))
        engine_output = run_engine(request.engine, stl, settings.global_, settings.extruder, limits, progress)
    return replace(engine_output, gcode=scale.restore_heights(engine_output.gcode))


def _change_hidden_walls(gcode: bytes, toolpath: Toolpath, request: PlateRequest) -> tuple[bytes, Toolpath]:
    """Change the walls along hidden sides (`slicing.glued_parts`); return the G-code and its moves."""
    sides, settings = request.hidden_sides, request.settings
    changes = (
        partial(remove_recess_skins, recesses=request.hidden_recesses, settings=settings),
        partial(remove_inner_walls, sides=sides, settings=settings),
        partial(reorder_inner_walls, settings=settings),
        partial(reorder_outlines, settings=settings),
        partial(reorder_infill, settings=settings),
        partial(speed_up_hidden_walls, sides=sides, recesses=request.hidden_recesses, settings=settings),
    )
    for change in changes if sides or request.hidden_recesses else ():
        new_gcode = change(gcode, toolpath)
        if new_gcode is not gcode:
            gcode, toolpath = new_gcode, read_toolpath(new_gcode)
    return gcode, toolpath


def _find_bed_centre(settings: EngineSettings) -> tuple[float, float]:
    return float(settings.global_["machine_width"]) / 2, float(settings.global_["machine_depth"]) / 2


def _check_bed(request: PlateRequest, facts: output.GcodeFacts) -> None:
    settings = request.settings
    max_layer_mm = max(settings.layer_height_mm, settings.layer_height_0_mm)
    output.check_bed(facts, _find_bed_centre(settings), request.bed, max_excess_mm=max_layer_mm / 2)


def _build_result(request: PlateRequest, sliced: CheckedSlice, cached: bool) -> PlateResult:
    settings, facts = request.settings, sliced.facts
    centre = (*_find_bed_centre(settings), 0.0)
    filament_mm3 = facts.filament_mm * settings.filament_mm2
    low_mm = tuple(facts.min_mm[i] - centre[i] for i in range(3))
    high_mm = tuple(facts.max_mm[i] - centre[i] for i in range(3))
    return PlateResult(
        gcode=request.output_path,
        sha256=hashlib.sha256(sliced.gcode).hexdigest(),
        sliced_s=facts.sliced_s,
        filament_mm=facts.filament_mm,
        filament_mm3=filament_mm3,
        grams=filament_mm3 / 1000 * settings.density_g_cm3,
        layers=facts.layers,
        height_mm=facts.max_mm[2],
        min_mm=(low_mm[0], low_mm[1], low_mm[2]),
        max_mm=(high_mm[0], high_mm[1], high_mm[2]),
        is_cached=cached,
        features=sliced.features,
        unprinted_walls=sliced.unprinted_walls,
    )
