"""`farm decompose`: one model, no daemon."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from decompose.auto import decompose_auto
from decompose.decompose import decompose_model
from decompose.export import write_decomposition
from decompose.file_names import ASSEMBLY, PICTURE, REPORT
from decompose.geometry import load_model
from decompose.options import BestOptions, Engine, Interior, Options, ParalleloboxOptions, Score
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from drivers.printers import PROFILES, part_room
from farm.errors import ErrorCode, FarmError, Refused
from farm.planning.error_translation import translate_errors
from farm.planning.parts.part_rooms import model_sizes
from farm.planning.parts.print_recipe import recipe
from farm.planning.slicing_printers import slicing_printer
from slicing.settings import SettingsRequest, find_resources, resolve_settings

MOST_PRINTERS = 100
"""That a number is chosen from, where a person names none."""


def decompose_to_folder(
    path: Path,
    out: Path,
    *,
    printers: int | None,
    volume_mm: tuple[float, float, float],
    brim_mm: float,
    longest_side_mm: float | None,
    scale: float | None,
    granularity: str | int,
    interior: str,
    min_wall_mm: float,
    min_glue_mm2: float,
    engine: str,
    seed: int,
    tries: int,
    score: str,
    faithful: bool,
    budget_s: float,
    clear_s: float,
    assemble_s: float,
) -> dict[str, Any]:
    """Cut a model and write parts, report and picture; the report, with what was repaired.

    Without a number of printers it is as many as are worth it, up to `MOST_PRINTERS`.

    Raises
    ------
    FarmError
        With the reason, in one line.
    """
    profile = max(
        PROFILES.values(), key=lambda p: (p.height_mm >= volume_mm[2], -p.height_mm)
    )  # the lowest that is high enough; the first of two is a 2+, which has the larger clips
    room = part_room(profile, brim_mm, volume_mm)
    if not room:
        raise FarmError(f"a brim of {brim_mm:g} mm leaves no room on that bed", ErrorCode.NO_FIT)
    try:
        kept = Interior(interior)
    except ValueError:
        raise FarmError(f"--interior {interior}: leave or keep", ErrorCode.SETTINGS) from None
    try:
        read = Score(score)
    except ValueError:
        raise FarmError(f"--score {score}: low, high or both", ErrorCode.SETTINGS) from None
    try:
        cutter = Engine(engine)
    except ValueError:
        known = ", ".join(Engine)
        raise FarmError(f"--engine {engine}: {known}", ErrorCode.SETTINGS) from None
    if faithful and cutter in (Engine.BEST, Engine.GUILLOTINE):
        raise FarmError(f"--faithful is for the engines of papers, not {cutter}", ErrorCode.SETTINGS)
    options = Options(
        engine=cutter,
        granularity=granularity,
        interior=kept,
        min_wall_mm=min_wall_mm,
        min_glue_mm2=min_glue_mm2,
        seed=seed,
        faithful=faithful,
        best=BestOptions(budget_s),
        parallelobox=ParalleloboxOptions(tries, read),
    )
    _empty_for_parts(out)
    with translate_errors():
        settings = resolve_settings(SettingsRequest(slicing_printer(profile)), find_resources())
        model = load_model(path, scale=scale, longest_side_mm=longest_side_mm)
        rooms = [
            PrinterRoom(str(number), model_sizes(room, settings))
            for number in range(printers or MOST_PRINTERS)
        ]
        cost = CostModel.from_recipe(replace(recipe(settings, prelude_s=0.0), brim_mm=brim_mm))
        with ThreadPoolExecutor(os.cpu_count()) as executor:
            if printers is None:
                handling = {"clear_s": clear_s, "assemble_s": assemble_s}
                found = decompose_auto(model, rooms, options, cost, executor, **handling)
            else:
                found = decompose_model(model, rooms, options, cost, executor)
            written = write_decomposition(found, out)
    return {**written.as_dict(), "repairs": list(model.repairs), "scale": model.scale}


def _empty_for_parts(out: Path) -> None:
    """Make the folder, without the parts that an earlier run left there.

    Raises
    ------
    Refused
        Where the folder has other things in it: parts of two models must not get mixed up.
    """
    report = out / REPORT
    try:
        out.mkdir(parents=True, exist_ok=True)
        ours = {REPORT, PICTURE, ASSEMBLY}
        if report.is_file():
            ours |= {str(part.get("file")) for part in json.loads(report.read_text())["parts"]}
        others = sorted(path.name for path in out.iterdir() if path.name not in ours)
        if others:
            raise Refused(f"{out}: holds other things ({others[0]}...); name an empty folder with --out")
        for name in ours:
            (out / name).unlink(missing_ok=True)
    except (ValueError, KeyError, TypeError) as error:
        raise Refused(f"{report}: is not ours; name an empty folder with --out") from error
    except OSError as error:
        raise FarmError(f"{out}: cannot be written ({error.strerror}); name another folder") from error
