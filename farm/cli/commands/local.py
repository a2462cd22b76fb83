"""The commands that need no daemon: `decompose` and `slice`."""

from __future__ import annotations

import contextlib
import json as jsonlib
import math
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from farm.cli.display.console import console
from farm.cli.display.decomposition import decomposition_lines
from farm.cli.display.format import filament
from farm.cli.options import Json
from farm.cli.printer_count import count_or_auto
from farm.errors import ErrorCode, FarmError
from farm.text import span


def decompose(
    model: Annotated[Path, typer.Argument(help="STL, OBJ, PLY or OFF.")],
    out: Annotated[Path, typer.Option(help="The folder for the parts.")],
    printers: Annotated[str, typer.Option(help="How many, or auto: as many as are worth it.")] = "8",
    volume: Annotated[str, typer.Option(help="A printer's volume X,Y,Z in mm.")] = "223,223,205",
    brim: Annotated[float, typer.Option(min=0, help="Width of the brim, mm.")] = 8.0,
    longest_side: Annotated[float | None, typer.Option(help="Scale it to this longest side, mm.")] = None,
    scale: Annotated[float | None, typer.Option(help="Scale it by this factor.")] = None,
    granularity: Annotated[str, typer.Option(help="auto, a name of the paper's, or cells a side.")] = "auto",
    interior: Annotated[str, typer.Option(help="leave or keep what lies deep inside.")] = "leave",
    min_wall: Annotated[float, typer.Option(min=0, help="Least wall around a hollow, mm.")] = 10.0,
    min_glue: Annotated[float, typer.Option(min=0, help="A joint of less area holds nothing, mm2.")] = 25.0,
    engine: Annotated[str, typer.Option(help="How to cut; best: guillotine and parallelobox.")] = "best",
    budget: Annotated[float, typer.Option(min=0, help="Of best: about the seconds of one core.")] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Of engines that draw.")] = 0,
    tries: Annotated[int, typer.Option(min=1, help="Of parallelobox, for each number of seeds.")] = 3,
    score: Annotated[str, typer.Option(help="Of parallelobox, the better: low, high, both.")] = "both",
    faithful: Annotated[bool, typer.Option("--faithful", help="As the engine's paper has it.")] = False,
    clear: Annotated[float, typer.Option(min=0, help="Of auto: to clear a bed takes a person, s.")] = 120.0,
    assemble: Annotated[float, typer.Option(min=0, help="Of auto: to glue a part takes, s.")] = 216.0,
    json: Json = False,
) -> None:
    """Cut a model into parts that finish together, and write them to a folder."""
    from farm.planning.local.decompose_file import decompose_to_folder

    size = _three(volume)
    report = decompose_to_folder(
        model,
        out,
        printers=count_or_auto(printers),
        volume_mm=size,
        brim_mm=brim,
        longest_side_mm=longest_side,
        scale=scale,
        granularity=int(granularity) if granularity.isdigit() else granularity,
        interior=interior,
        min_wall_mm=min_wall,
        min_glue_mm2=min_glue,
        engine=engine,
        seed=seed,
        tries=tries,
        score=score,
        faithful=faithful,
        budget_s=budget,
        clear_s=clear,
        assemble_s=assemble,
    )
    if json:
        print(jsonlib.dumps(report, indent=2))
        return
    for line in decomposition_lines(report, count_or_auto(printers) or len(report["parts"]), out):
        print(line)


def slice_model(
    model: Annotated[Path, typer.Argument(help="STL, OBJ, PLY or OFF in mm; it is printed as it stands.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The G-code file.")],
    printer_model: Annotated[str, typer.Option(help="Cura's definition id.")] = "ultimaker2_plus",
    quality: Annotated[str, typer.Option(help="glue, paper, or one of Cura's.")] = "glue",
    material: Annotated[str, typer.Option(help="Cura's material id.")] = "generic_pla",
    nozzle: Annotated[float, typer.Option(help="The nozzle's size, mm.")] = 0.4,
    set_: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE of a Cura setting.")] = None,
    longest_side: Annotated[float | None, typer.Option(help="Scale it to this longest side, mm.")] = None,
    scale: Annotated[float | None, typer.Option(help="Scale it by this factor (1000: metres).")] = None,
    price_per_kg: Annotated[float | None, typer.Option(min=0, help="Of the reel: adds the price.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Where slices are kept; else the XDG cache.")] = None,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Slice anew, and keep nothing.")] = False,
    json: Json = False,
) -> None:
    """Slice one model as one plate, with all checks, for USB streaming. No daemon is needed."""
    from farm.planning.local.slice_file import default_cache, slice_to_file

    overrides = {}
    for pair in set_ or []:
        key, equals, value = pair.partition("=")
        if not equals:
            raise FarmError(f"--set {pair}: write KEY=VALUE", ErrorCode.SETTINGS)
        overrides[key] = value
    signal.signal(signal.SIGTERM, _end)
    with _working() as tell:
        report = slice_to_file(
            model,
            out,
            printer_model=printer_model,
            quality=quality,
            material=material,
            nozzle_mm=nozzle,
            overrides=overrides,
            scale=scale,
            longest_side_mm=longest_side,
            cache=None if no_cache else cache or default_cache(),
            tell=tell,
        )
    if price_per_kg is not None:
        report["price"] = report["grams"] / 1000 * price_per_kg
    if json:
        print(jsonlib.dumps(report, indent=2))
        return
    for line in (*report["repairs"], *report["warnings"]):
        print(f"  {line}")
    amount = filament(report["grams"], report["filament_mm"], report.get("price"))
    print(
        f"{out}: {span(report['print_time_s'])} (with heating {span(report['estimated_s'])}), {amount}, "
        f"{report['layers']} layers{', from the cache' if report['cached'] else ''}"
    )


def _end(number: int, _: object) -> NoReturn:
    """End as with Ctrl-C: the engine and the temporary files go too."""
    sys.exit(128 + number)


@contextlib.contextmanager
def _working() -> Iterator[Callable[[str], None]]:
    """Shows on a terminal what is being done, and for how long already."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(
        *columns, console=console(stderr=True), transient=True, disable=not sys.stderr.isatty()
    ) as shown:
        task = shown.add_task("starting")
        yield lambda text: shown.update(task, description=escape(text))


def _three(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(side) for side in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(0 < side < math.inf for side in (x, y, z)):
        raise typer.BadParameter("three numbers above 0, in mm: X,Y,Z", param_hint="--volume")
    return x, y, z
