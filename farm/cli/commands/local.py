"""`farm decompose`, `farm slice`, `farm coupon` and `farm worker`: commands that need no daemon."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from decompose.options import PIN_FIT_MM, ConnectorOptions
from drivers.locks import acquire_lock
from farm.cli.display import open_console, print_json
from farm.cli.display.decomposition import summarise_decomposition
from farm.cli.notices import print_notice
from farm.cli.options import (
    Certificates,
    Json,
    LongestSide,
    Marks,
    PinFit,
    Pins,
    Quality,
    Scale,
    Scheduler,
    parse_pins,
    parse_printer_count,
    parse_scheduler,
)
from farm.errors import ErrorCode, FarmError, RefusedError
from farm.text import format_duration
from farm.wording import format_filament

_MAX_SLOTS = 256


def decompose(
    model: Annotated[Path, typer.Argument(help="STL, 3MF, STEP, OBJ, PLY or OFF.")],
    out: Annotated[Path, typer.Option(help="The folder for the parts.")],
    printers: Annotated[
        str, typer.Option(help="The number of printers, or auto: the number that saves the most time.")
    ] = "8",
    volume: Annotated[str, typer.Option(help="Build volume of a printer, X,Y,Z in mm.")] = "223,223,205",
    brim: Annotated[float, typer.Option(min=0, help="Width of the brim, mm.")] = 8.0,
    longest_side: LongestSide = None,
    scale: Scale = None,
    granularity: Annotated[
        str, typer.Option(help="auto, a name from the paper, or cells per side.")
    ] = "auto",
    interior: Annotated[
        str, typer.Option(help="leave: leave the interior hollow; keep: print it.")
    ] = "leave",
    min_wall: Annotated[float, typer.Option(min=0, help="Thinnest wall around the hollow, mm.")] = 10.0,
    min_glue: Annotated[float, typer.Option(min=0, help="Smallest area of a joint that holds, mm2.")] = 25.0,
    engine: Annotated[str, typer.Option(help="The algorithm; best: guillotine on several grids.")] = "best",
    budget: Annotated[
        float, typer.Option(min=0, help="best: approximate computing time, in seconds of one core.")
    ] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Random seed, for engines that use one.")] = 0,
    tries: Annotated[int, typer.Option(min=1, help="parallelobox: attempts for each number of seeds.")] = 3,
    score: Annotated[
        str, typer.Option(help="parallelobox: prefer a low or a high score, or try both.")
    ] = "both",
    faithful: Annotated[bool, typer.Option("--faithful", help="Follow the engine's paper exactly.")] = False,
    pins: Pins = "none",
    pin_fit: PinFit = None,
    marks: Marks = False,
    clear: Annotated[float, typer.Option(min=0, help="--printers auto: time to clear a bed, s.")] = 120.0,
    assemble: Annotated[float, typer.Option(min=0, help="--printers auto: time to glue a part, s.")] = 216.0,
    quality: Quality = "glue",
    slice_: Annotated[
        bool, typer.Option("--slice", help="Write G-code too, and balance the parts by their sliced times.")
    ] = False,
    scheduler: Scheduler = None,
    certificates: Certificates = None,
    json: Json = False,
) -> None:
    """Cut a model into parts of about equal printing time, and write them to a folder."""
    from farm.planning.local.decompose_file import DecomposeRequest, decompose_to_folder
    from farm.planning.local.slice_file import find_default_cache

    request = DecomposeRequest(
        volume_mm=_parse_volume(volume),
        printer_count=parse_printer_count(printers),
        brim_mm=brim,
        longest_side_mm=longest_side,
        scale=scale,
        granularity=int(granularity) if granularity.isdigit() else granularity,
        interior=interior,
        min_wall_mm=min_wall,
        min_glue_mm2=min_glue,
        engine=engine,
        seed=seed,
        attempt_count=tries,
        score=score,
        is_faithful=faithful,
        budget_s=budget,
        clearing_s=clear,
        assembly_s=assemble,
        quality=quality,
        slices_parts=slice_,
        connectors=ConnectorOptions(parse_pins(pins), PIN_FIT_MM if pin_fit is None else pin_fit, marks),
    )
    if slice_:
        signal.signal(signal.SIGTERM, _exit)
    cache = find_default_cache() if slice_ else None
    if scheduler is None:
        report = decompose_to_folder(model, out, request, cache)
    else:
        from farm.planning.local.on_cluster import Cluster, decompose_on_cluster

        cluster = Cluster(parse_scheduler(scheduler), certificates, print_notice)
        report = decompose_on_cluster(cluster, model, out, request, cache)
    if json:
        print_json(report)
        return
    for line in summarise_decomposition(report, parse_printer_count(printers) or len(report["parts"]), out):
        print(line)


def slice_model(
    model: Annotated[Path, typer.Argument(help="STL, 3MF, STEP, OBJ, PLY or OFF; it is not turned.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The G-code file.")],
    printer_model: Annotated[str, typer.Option(help="Cura's definition id.")] = "ultimaker2_plus",
    quality: Quality = "glue",
    material: Annotated[str, typer.Option(help="PLA, or Cura's name of a material.")] = "generic_pla",
    nozzle: Annotated[float, typer.Option(help="Nozzle size, mm.")] = 0.4,
    set_: Annotated[list[str] | None, typer.Option("--set", help="A Cura setting, KEY=VALUE.")] = None,
    longest_side: LongestSide = None,
    scale: Scale = None,
    price_per_kg: Annotated[
        float | None, typer.Option(min=0, help="Price of the filament, to show the price of the print.")
    ] = None,
    cache: Annotated[
        Path | None, typer.Option(help="Folder of the slice cache; default: the XDG cache.")
    ] = None,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Do not use the slice cache.")] = False,
    scheduler: Scheduler = None,
    certificates: Certificates = None,
    json: Json = False,
) -> None:
    """Slice a model as one plate for printing over USB, with all checks."""
    from farm.planning.local.slice_file import SliceOptions, find_default_cache, slice_to_file

    overrides = _parse_overrides(set_ or [])
    signal.signal(signal.SIGTERM, _exit)
    with _show_step() as show_step:
        options = SliceOptions(printer_model, quality, material, nozzle, overrides, scale, longest_side)
        slices = None if no_cache else cache or find_default_cache()
        if scheduler is None:
            report = slice_to_file(model, out, options, slices, show_step)
        else:
            from farm.planning.local.on_cluster import Cluster, slice_on_cluster

            show_step("slicing on the cluster")
            cluster = Cluster(parse_scheduler(scheduler), certificates, print_notice)
            report = slice_on_cluster(cluster, model, out, options, slices)
    if price_per_kg is not None:
        report["price"] = report["grams"] / 1000 * price_per_kg
    if json:
        print_json(report)
        return
    for line in _describe_slice(report, out):
        print(line)


def _parse_overrides(pairs: Iterable[str]) -> dict[str, str]:
    """Parse Cura settings, KEY=VALUE."""
    overrides = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise FarmError(f"--set {pair}: must be KEY=VALUE", ErrorCode.SETTINGS)
        overrides[key] = value
    return overrides


def _describe_slice(report: Mapping[str, Any], out: Path) -> Iterator[str]:
    """Yield the repairs and warnings of a sliced model, and a line with its times and its filament."""
    for line in (*report["repairs"], *report["warnings"]):
        yield f"  {line}"
    amount = format_filament(report["grams"], report["filament_mm"], report.get("price"))
    print_time, total_time = format_duration(report["print_time_s"]), format_duration(report["estimated_s"])
    yield (
        f"{out}: {print_time} (with heating {total_time}), {amount}, "
        f"{report['layers']} layers{', from the cache' if report['cached'] else ''}"
    )


def coupon(
    out: Annotated[Path, typer.Option("-o", "--out", help="The STL file.")] = Path("coupon.stl"),
    pins: Pins = "filament",
    json: Json = False,
) -> None:
    """Write a block with holes and grooves of several widths, to find the fit of pins on a printer."""
    from farm.planning.local.coupon_file import write_coupon

    report = write_coupon(out, parse_pins(pins))
    if json:
        print_json(report)
        return
    *longer, shortest = (f"{length_mm:g}" for length_mm in report["lengths_mm"])
    lengths = f"{', '.join(longer)} and {shortest}"
    fits = report["fits_mm"]
    print(
        f"{out}: holes and grooves {fits[0]:g} to {fits[-1]:g} mm wider than a pin "
        f"of {report['pin_mm']:g} mm, numbered in tenths of a millimetre; gauges for pins and keys "
        f"{lengths} mm long"
    )
    print(
        "Slice the coupon as it is with `farm slice`; write the number that fits, in mm (4: 0.4), as "
        "`pin_fit_mm` into fleet.yaml"
    )


def _exit(signal_number: int, _: object) -> NoReturn:
    """Exit as after Ctrl-C, so that CuraEngine is ended and temporary files are removed."""
    sys.exit(128 + signal_number)


@contextlib.contextmanager
def _show_step() -> Iterator[Callable[[str], None]]:
    """Show the current step and its duration on a terminal; yield a function that sets the step."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(
        *columns, console=open_console(stderr=True), transient=True, disable=not sys.stderr.isatty()
    ) as progress:
        task = progress.add_task("starting")
        yield lambda text: progress.update(task, description=escape(text))


def _parse_volume(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(side) for side in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(0 < side < math.inf for side in (x, y, z)):
        raise typer.BadParameter("must be three numbers above 0, in mm: X,Y,Z", param_hint="--volume")
    return x, y, z


def worker(
    scheduler: Annotated[str, typer.Argument(help="Address of the scheduler: tls://HOST:PORT.")],
    certificates: Certificates = None,
    name: Annotated[str | None, typer.Option(help="Name; default: that of this host.")] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Folder for the files of this worker only; default: the XDG cache.")
    ] = None,
    slots: Annotated[
        int | None,
        typer.Option(
            min=1, max=_MAX_SLOTS, help="Maximum number of simultaneous tasks; default: one for each core."
        ),
    ] = None,
    memory_gb: Annotated[
        float | None,
        typer.Option(min=1, help="Memory limit of each task, GB; default: an equal share of the memory."),
    ] = None,
) -> None:
    """Run tasks of farms on this computer, as a worker of a Dask cluster."""
    from farm.compute.cluster.security import check_cluster

    parse_scheduler(scheduler)
    check_cluster(scheduler, certificates)
    from farm.compute.cluster.worker_service import WorkerOptions, serve_tasks  # loads Dask
    from farm.planning.error_translation import translate_errors
    from farm.planning.tasks import warm_up_planning

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    name = name or socket.gethostname()
    options = WorkerOptions(
        scheduler,
        certificates,
        name,
        (folder or _choose_folder(name)).absolute(),
        slots or len(os.sched_getaffinity(0)),
        memory_gb,
    )
    options.folder.mkdir(parents=True, exist_ok=True)
    if acquire_lock(options.folder / "lock") is None:  # the lock is held until this process ends
        raise RefusedError(f"another worker uses {options.folder}: give each its own --folder")
    with translate_errors():
        asyncio.run(serve_tasks(options, warm_up_planning))


def _choose_folder(name: str) -> Path:
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "farm" / "workers" / name
