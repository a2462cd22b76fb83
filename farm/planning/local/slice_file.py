"""Slicing of one model as one plate without a daemon (`farm slice`)."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import trimesh

from decompose.geometry import Model, load_model
from drivers.printers import SLICING_PROFILES, Profile, UsableVolume, list_usable_volumes, place_part
from farm.compute import read_process_memory_bytes
from farm.errors import ErrorCode, FarmError
from farm.planning.error_translation import translate_errors
from farm.planning.inspection.materials import choose_material
from farm.planning.part_records import SliceTask
from farm.planning.parts.slice_part import resolve_slice_settings, slice_part
from farm.planning.plate_times import compute_plate_seconds
from farm.planning.printer_settings import build_slicing_printer
from slicing.cache_limit import trim_cache
from slicing.errors import suggest_names
from slicing.plate import PlateResult
from slicing.settings import EngineSettings, SettingsRequest, find_engine, find_resources, resolve_settings

StepListener = Callable[[str], None]
_SUGGESTED_SHARE = 0.99  # share of the largest size that fits; less than 1, because messages round it


def find_default_cache(env: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder of the slice cache in the XDG cache folder; None if it cannot be written."""
    folder = Path(env.get("XDG_CACHE_HOME") or Path(env.get("HOME", "/")) / ".cache") / "farm" / "slices"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


@dataclass(frozen=True, slots=True)
class SliceOptions:
    """Options of `farm slice`.

    Attributes
    ----------
    printer_model, quality, material, nozzle_mm, overrides
        See `slicing.settings.SettingsRequest`; `printer_model` is the name of a model.
    scale, longest_side_mm
        See `decompose.geometry.load_model`.
    """

    printer_model: str
    quality: str
    material: str
    nozzle_mm: float
    overrides: Mapping[str, str] = field(default_factory=dict)
    scale: float | None = None
    longest_side_mm: float | None = None


def slice_to_file(
    path: Path,
    out: Path,
    options: SliceOptions,
    cache: Path | None = None,
    on_step: StepListener = lambda _: None,
) -> dict[str, Any]:
    """Slice a model without turning it, in the middle of the bed; return the report of `farm slice --json`.

    Parameters
    ----------
    out
        The G-code file, which is replaced atomically.
    cache
        Folder of the slice cache, see `slicing.plate`.
    on_step
        Called with the name of each step.

    Raises
    ------
    FarmError
        If the model cannot be sliced; the message is one line with the reason.
    """
    profile, request = _find_settings(options)
    check_output_file(out, path)
    with translate_errors():
        resources, engine = find_resources(), find_engine()
        named_material = choose_material(options.material, request.printer, options.nozzle_mm, resources)
        request = replace(request, material=named_material.name)
        settings = resolve_settings(request, resources)
        model = _read_model(path, options, on_step)
    usable_volumes = _find_usable_volumes(path.name, model, settings, profile)
    with tempfile.TemporaryDirectory(prefix="farm-slice-") as folder:
        task = SliceTask(
            part_name=path.name,
            stl=Path(folder) / "model.stl",
            request=request,
            resources=resources,
            settings=settings,
            usable_volumes=usable_volumes,
            engine=engine,
            out=Path(folder) / "model.gcode",
            cache=cache,
        )
        report = _slice_model(model, task, profile, on_step)
        _write_output(task.out, out)
    if cache is not None:
        trim_cache(cache)
    return report


def _find_settings(options: SliceOptions) -> tuple[Profile, SettingsRequest]:
    """Find the printer's profile, and build the request for its settings."""
    profile = _find_profile(options.printer_model)
    request = SettingsRequest(
        build_slicing_printer(profile),
        options.quality,
        options.material,
        options.nozzle_mm,
        options.overrides,
    )
    return profile, request


def _read_model(path: Path, options: SliceOptions, on_step: StepListener) -> Model:
    """Read a model, in the requested size."""
    return load_model(
        path,
        scale=options.scale,
        longest_side_mm=options.longest_side_mm,
        memory_bytes=read_process_memory_bytes(),
        report=lambda step: on_step(f"{path.name}: {step}"),
    )


def _find_usable_volumes(
    name: str, model: Model, settings: EngineSettings, profile: Profile
) -> tuple[UsableVolume, ...]:
    """Return the volumes that the brim leaves free. Raises FarmError if the model fits into none of them."""
    usable_volumes = list_usable_volumes(profile, settings.brim_width_mm)
    size_mm = _compute_printed_size_mm(model, settings)
    if place_part(size_mm, usable_volumes) is None:
        raise FarmError(
            f"{name} ({_format_size(size_mm)} mm as printed) does not fit the {profile.title}: "
            + _suggest_size(size_mm, usable_volumes, float(max(model.extents_mm)), model.scale),
            ErrorCode.NO_FIT,
        )
    return usable_volumes


def _compute_printed_size_mm(model: Model, settings: EngineSettings) -> tuple[float, float, float]:
    """Return the printed size (x, y, z) of a model, which is enlarged to compensate for shrinkage."""
    x, y, z = map(float, model.extents_mm)
    return x * settings.scale_xy, y * settings.scale_xy, z * settings.scale_z


def _slice_model(model: Model, task: SliceTask, profile: Profile, on_step: StepListener) -> dict[str, Any]:
    """Slice a model into the file of its task; return the report."""
    model.mesh.export(task.stl)
    on_step(f"slicing {task.part_name}")
    result = slice_part(task, lambda share: on_step(f"slicing {task.part_name}, {share:.0%}"))
    mesh: Any = trimesh.load_mesh(task.stl)
    mesh.apply_scale((task.settings.scale_xy, task.settings.scale_xy, task.settings.scale_z))
    with translate_errors():
        settings = resolve_slice_settings(task, mesh)
    return _build_report(model, result, settings, profile)


def _find_profile(printer_model: str) -> Profile:
    if printer_model not in SLICING_PROFILES:
        hint = (
            suggest_names(printer_model, SLICING_PROFILES)
            or f"; known are {', '.join(sorted(SLICING_PROFILES))}"
        )
        raise FarmError(f"--printer-model {printer_model}: no such printer{hint}", ErrorCode.SETTINGS)
    return SLICING_PROFILES[printer_model]


def _build_report(
    model: Model, result: PlateResult, settings: EngineSettings, profile: Profile
) -> dict[str, Any]:
    """Build the report of `farm slice --json`, whose field names are fixed."""
    return {
        "schema": 1,
        "repairs": list(model.repairs),
        "scale": model.scale,
        "print_time_s": result.sliced_s,
        "estimated_s": compute_plate_seconds(profile, result.sliced_s, settings.nozzle_c, settings.bed_c),
        "filament_mm": result.filament_mm,
        "filament_mm3": result.filament_mm3,
        "grams": result.grams,
        "layers": result.layers,
        "cached": result.is_cached,
        "unprinted": [asdict(wall) for wall in result.unprinted_walls],
        "warnings": [str(wall) for wall in result.unprinted_walls],
        "settings": {"global": settings.global_, "extruder": settings.extruder},
    }


def _suggest_size(
    size_mm: tuple[float, float, float],
    usable_volumes: tuple[UsableVolume, ...],
    longest_mm: float,
    scale: float,
) -> str:
    """Describe the largest usable volume, and the largest scale at which the model fits into it."""
    x, y, z = size_mm
    shares = [
        (min(width / dx, depth / dy, height / z), (width, depth, height))
        for width, depth, height in (box.size_mm for box in usable_volumes)
        for dx, dy in ((x, y), (y, x))
    ]
    if not shares:
        return "its brim leaves no room on that bed; make the brim narrower (--set brim_width=4)"
    share, largest_mm = max(shares)
    share *= _SUGGESTED_SHARE
    return (
        f"there is room for {_format_size(largest_mm)} mm beside the brim; `farm decompose` cuts the model "
        f"into parts, or make it smaller with --scale {scale * share:.3g} or "
        f"--longest-side {longest_mm * share:.0f}"
    )


def _format_size(size_mm: tuple[float, float, float]) -> str:
    return " x ".join(f"{side:.1f}" for side in size_mm)


def check_output_file(out: Path, model: Path) -> None:
    """Check that a file can be written, before slow work, without creating it. Raises FarmError."""
    try:
        if out.is_dir():
            raise _make_write_error(out, "it is a folder")
        if out.exists() and model.exists() and out.samefile(model):
            raise _make_write_error(out, "it is the model")
        parent = next(path for path in (out, *out.absolute().parents) if path.exists())
        if parent is not out and not parent.is_dir():
            raise _make_write_error(out, f"{parent} is not a folder")
    except OSError as error:
        raise _make_write_error(out, error.strerror) from error
    if not os.access(parent, os.W_OK):
        raise _make_write_error(out, "no permission")


def _write_output(gcode: Path, out: Path) -> None:
    """Replace the output file atomically; write directly into a device or a pipe."""
    try:
        if out.exists() and not out.is_file():
            shutil.copyfile(gcode, out)
            return
        target = out.resolve()
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            shutil.copyfile(gcode, temporary)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise _make_write_error(out, error.strerror) from error


def _make_write_error(out: Path, reason: str | None) -> FarmError:
    return FarmError(f"{out}: cannot be written ({reason}); name another file with --out")
