"""Inspection of a submitted file before its job is accepted: a model is read, repaired and scaled once."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from decompose.errors import ModelTooDetailed
from decompose.geometry import Model, Solid, load_model
from farm.compute import read_process_memory_bytes
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, ModelSize
from farm.planning.error_translation import translate_errors
from farm.planning.inspection.own_gcode import inspect_gcode, is_gcode
from farm.planning.plan import InspectedSubmission, make_inspection_step_path
from farm.planning.printer_settings import check_settings
from farm.state.storage import store_file
from slicing.settings import find_engine, find_resources


def inspect_submission(
    path: Path, name: str, options: JobOptions, printers: Sequence[PrinterSection], files: Path
) -> InspectedSubmission:
    """Check a submission, and put its printable content into the file store.

    Parameters
    ----------
    path
        The upload; the current step is written to the file that `make_inspection_step_path` returns.
    name
        The file's name as submitted; its suffix distinguishes models from G-code.
    options
        Options of the submission.
    printers
        The fleet.
    files
        The file store.

    Raises
    ------
    FarmError
        See `inspect_gcode`, `check_settings` and `inspect_model`.
    """
    if is_gcode(name):
        return inspect_gcode(path, name, options, printers, files)
    check_settings(printers, options)

    def report(step: str) -> None:
        make_inspection_step_path(path).write_text(step)

    return inspect_model(path, name, options, files, report)


def inspect_model(
    path: Path, name: str, options: JobOptions, files: Path, report: Callable[[str], None] = lambda _: None
) -> InspectedSubmission:
    """Read, repair and scale a model, and store it as a solid; runs in a worker.

    Parameters
    ----------
    name
        The file's name as submitted.
    files
        The file store.
    report
        Called with the name of the current step.

    Raises
    ------
    FarmError
        With code `model` and the reason if the model is not a solid and cannot be repaired; `limit` if this
        process has too little memory for it; `engine` if CuraEngine is missing.
    """
    with translate_errors():
        find_engine()
        find_resources()
        try:
            model = load_model(
                path,
                name=name,
                scale=options.scale,
                longest_side_mm=options.longest_side_mm,
                memory_bytes=read_process_memory_bytes(),
                report=report,
            )
        except ModelTooDetailed as error:
            detail = f"{error}, or raise `fleet.compute.memory_gb` in fleet.yaml"
            raise FarmError(detail, ErrorCode.LIMIT) from error
        vertices, faces = model.solid.arrays()
    report("storing")
    temporary = path.with_name(f"solid-{uuid.uuid4().hex}.npz")
    np.savez_compressed(
        temporary,
        vertices=vertices,
        faces=faces,
        scale=model.scale,
        repairs=np.array(model.repairs, dtype=np.str_),
    )
    x, y, z = map(float, model.extents_mm)
    size = ModelSize(extents_mm=(x, y, z), faces=len(faces))
    file_name = store_file(files, temporary)
    return InspectedSubmission(file_name, tuple(model.repairs), float(model.scale), size=size)


def read_inspected_model(path: Path) -> Model:
    """Read the model that `inspect_model` stored, without loss. Raises FarmError with code `model`."""
    try:
        with np.load(path) as arrays:
            solid = Solid.from_arrays(arrays["vertices"], arrays["faces"])
            return Model(solid, tuple(map(str, arrays["repairs"])), float(arrays["scale"]))
    except (OSError, ValueError, KeyError) as error:
        raise FarmError(f"the stored model {path} cannot be read: {error}", ErrorCode.MODEL) from error
