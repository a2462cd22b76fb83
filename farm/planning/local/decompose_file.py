"""Decomposition of one model without a daemon (`farm decompose`)."""

from __future__ import annotations

import json
import os
import tempfile
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from decompose.advised_size import advise_longest_side_mm
from decompose.auto import CountGoal, decompose_for_goal
from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.export import write_decomposition
from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE, REPORT
from decompose.geometry import Model, load_model
from decompose.options import (
    BestOptions,
    ConnectorOptions,
    Engine,
    Interior,
    Options,
    ParalleloboxOptions,
    Score,
)
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Decomposition
from drivers.printers import PROFILES, Profile, list_usable_volumes
from farm.compute import read_process_memory_bytes
from farm.errors import ErrorCode, FarmError, RefusedError
from farm.planning.error_translation import translate_errors
from farm.planning.local.sliced_parts import PartSlicer, rebalance_by_slices, write_sliced_parts
from farm.planning.parts.bed_places import Bed
from farm.planning.parts.pricing import build_print_time_settings, select_connectors
from farm.planning.printer_settings import build_slicing_printer, list_max_part_sizes_mm
from slicing.cache_limit import trim_cache
from slicing.settings import (
    DEFAULT_QUALITY,
    FARM_QUALITIES,
    EngineSettings,
    SettingsRequest,
    find_resources,
    resolve_settings,
)

MAX_PRINTERS = 100
"""Maximum number of printers for `auto`."""
_PAPER_ENGINES = (Engine.PARALLELOBOX, Engine.SYMMETRY, Engine.CUBE_SKELETON)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecomposeRequest:
    """Options of `farm decompose`; fields that are not listed are those of `Options` and `load_model`.

    Attributes
    ----------
    printer_count
        Number of printers; None for the number that saves the most time, at most `MAX_PRINTERS`.
    volume_mm
        Build volume of a printer: x, y, z.
    interior, engine, score
        Values of `Interior`, `Engine` and `Score`.
    attempt_count
        Number of attempts that the engine `parallelobox` makes for each number of seeds. A seed is a cell
        from which a part grows.
    is_faithful
        True to run the engine exactly as its paper describes it.
    budget_s
        Time budget of the engine `best`.
    clearing_s, assembly_s
        Time to clear a bed, and to glue a part; each additional part must save more than their sum.
    quality
        Quality with which parts are priced and sliced.
    slices_parts
        True to slice the parts, and to move the cuts according to the sliced times.
    connectors
        Pins and marks.
    """

    printer_count: int | None
    volume_mm: tuple[float, float, float]
    brim_mm: float
    longest_side_mm: float | None
    scale: float | None
    granularity: str | int
    interior: str
    min_wall_mm: float
    min_glue_mm2: float
    engine: str
    seed: int
    attempt_count: int
    score: str
    is_faithful: bool
    budget_s: float
    clearing_s: float
    assembly_s: float
    quality: str = DEFAULT_QUALITY
    slices_parts: bool = False
    connectors: ConnectorOptions = field(default_factory=ConnectorOptions)


def decompose_to_folder(
    path: Path, out: Path, request: DecomposeRequest, cache: Path | None = None
) -> dict[str, Any]:
    """Cut a model, and write its parts, report and picture, and the G-code of the parts if requested.

    Parameters
    ----------
    cache
        Folder of the slice cache, see `slicing.plate`.

    Returns
    -------
    dict[str, Any]
        The report, with `repairs` and `scale` of the model.

    Raises
    ------
    FarmError
        If the model cannot be cut; the message is one line with the reason.
    """
    profile = _choose_profile(request.volume_mm[2])
    usable_volumes = list_usable_volumes(profile, request.brim_mm, request.volume_mm)
    if not usable_volumes:
        raise FarmError(f"a brim of {request.brim_mm:g} mm leaves no room on that bed", ErrorCode.NO_FIT)
    options = _build_options(request)  # refused before the folder is emptied
    prepare_output_folder(out)
    with translate_errors(), ThreadPoolExecutor(os.cpu_count()) as executor:
        resources = find_resources()
        settings_request = SettingsRequest(build_slicing_printer(profile), request.quality, has_support=True)
        settings = resolve_settings(settings_request, resources)
        scale, longest_side_mm = request.scale, request.longest_side_mm
        memory_bytes = read_process_memory_bytes()
        model = load_model(path, scale=scale, longest_side_mm=longest_side_mm, memory_bytes=memory_bytes)
        cost = _build_cost_model(settings, request.brim_mm)
        decomposition = _decompose(
            model, list_max_part_sizes_mm(usable_volumes, settings), request, options, cost, executor
        )
        if request.slices_parts:
            brim_request = replace(settings_request, overrides={"brim_width": f"{request.brim_mm:g}"})
            slicer = PartSlicer(brim_request, resources, usable_volumes, cache)
            with tempfile.TemporaryDirectory(prefix="farm-decompose-") as work:
                sliced_parts = rebalance_by_slices(model, decomposition, slicer, cost, executor, Path(work))
                report = write_sliced_parts(sliced_parts, out)
            if cache is not None:
                trim_cache(cache)
        else:
            bed = Bed(profile.bed_mm, usable_volumes, settings)
            report = write_decomposition(decomposition, out, bed.place).as_dict()
    return {**report, "repairs": list(model.repairs), "scale": model.scale}


def _choose_profile(height_mm: float) -> Profile:
    """Choose the profile with the lowest sufficient build height.

    Of several profiles with that height, the first is chosen, because the clips on its bed are the largest.
    """
    return max(PROFILES.values(), key=lambda p: (p.height_mm >= height_mm, -p.height_mm))


def _build_cost_model(settings: EngineSettings, brim_mm: float) -> CostModel:
    """Build the cost model of the settings, with another brim width."""
    return CostModel.from_settings(
        replace(build_print_time_settings(settings, overhead_s=0.0), brim_mm=brim_mm)
    )


def _decompose(
    model: Model,
    sizes_mm: tuple[tuple[float, float, float], ...],
    request: DecomposeRequest,
    options: Options,
    cost: CostModel,
    executor: Executor,
) -> Decomposition:
    """Decompose a model for identical printers, which can print a part that fits into one of the sizes.

    Raises
    ------
    NoFit
        If the model is too large; the message contains the largest tested size that fits.
    """
    printers = [
        TargetPrinter(str(number), sizes_mm) for number in range(request.printer_count or MAX_PRINTERS)
    ]
    try:
        if request.printer_count is None:
            goal = CountGoal(request.clearing_s, request.assembly_s)
            return decompose_for_goal(model, printers, options, cost, executor, goal)
        return decompose_model(model, printers, options, cost, executor)
    except NoFit as error:
        side_mm = (
            advise_longest_side_mm(model, printers, options, cost, executor) if error.is_too_large else None
        )
        if side_mm is None:
            raise
        raise NoFit(f"{error} (--longest-side {side_mm} was tried, and fits)") from error


def _build_options(request: DecomposeRequest) -> Options:
    """Build the decomposition's options. Raises FarmError if a name is unknown."""
    try:
        interior = Interior(request.interior)
    except ValueError:
        raise FarmError(f"--interior {request.interior}: use leave or keep", ErrorCode.SETTINGS) from None
    try:
        score = Score(request.score)
    except ValueError:
        raise FarmError(f"--score {request.score}: use low, high or both", ErrorCode.SETTINGS) from None
    try:
        engine = Engine(request.engine)
    except ValueError:
        engines = ", ".join(Engine)
        raise FarmError(f"--engine {request.engine}: use one of {engines}", ErrorCode.SETTINGS) from None
    if request.is_faithful and engine not in _PAPER_ENGINES:
        raise FarmError(f"--faithful is for the engines of papers, not {engine}", ErrorCode.SETTINGS)
    if request.is_faithful and not request.connectors.is_empty:
        raise FarmError("--faithful cannot be combined with --pins or --marks", ErrorCode.SETTINGS)
    quality = FARM_QUALITIES.get(request.quality)
    return Options(
        engine=engine,
        granularity=request.granularity,
        interior=interior,
        min_wall_mm=request.min_wall_mm,
        min_glue_mm2=request.min_glue_mm2,
        seed=request.seed,
        faithful=request.is_faithful,
        fit_first_layer=quality is not None and quality.fits_first_layer,
        best=BestOptions(request.budget_s),
        parallelobox=ParalleloboxOptions(request.attempt_count, score),
        connectors=select_connectors(request.connectors, request.quality),
    )


def prepare_output_folder(out: Path) -> None:
    """Create the folder, and remove the parts of an earlier run.

    Raises
    ------
    RefusedError
        If the folder contains other files, because parts of two models must not be mixed.
    """
    report = out / REPORT
    try:
        out.mkdir(parents=True, exist_ok=True)
        own_files = {REPORT, PICTURE, ASSEMBLY, INSTRUCTIONS}
        if report.is_file():
            parts = json.loads(report.read_text())["parts"]
            own_files |= {str(part.get(key)) for part in parts for key in ("file", "gcode")}
        foreign_files = sorted(path.name for path in out.iterdir() if path.name not in own_files)
        if foreign_files:
            raise RefusedError(
                f"{out}: contains other files ({foreign_files[0]}...); give an empty folder with --out"
            )
        for name in own_files:
            (out / name).unlink(missing_ok=True)
    except (ValueError, KeyError, TypeError) as error:
        raise RefusedError(
            f"{report}: was not written by `farm decompose`; give an empty folder with --out"
        ) from error
    except OSError as error:
        raise FarmError(f"{out}: cannot be written ({error.strerror}); name another folder") from error
