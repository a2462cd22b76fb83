"""Compilation of all functions that run as machine code; `farm setup` starts it before the first model.

``python -m decompose.compilation`` takes about a minute; it does nothing if the code is already compiled.
"""

from __future__ import annotations

import fcntl
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from decompose.decompose import decompose_model
from decompose.engines.guillotine.least_work import LeastWorkSearch
from decompose.engines.guillotine.price_excess import add_box_sums
from decompose.export import write_decomposition
from decompose.geometry import load_model, write_stl
from decompose.grid import BoxTables
from decompose.jit import CODE_FOLDER, INSTALLED_FOLDER, is_compiled, mark_compiled
from decompose.options import BestOptions, Engine, Options, ParalleloboxOptions
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter

_PRINTER = TargetPrinter("", ((90.0, 90.0, 60.0),))
_QUICK_OPTIONS = Options(
    granularity=6, best=BestOptions(budget_s=0.0), parallelobox=ParalleloboxOptions(tries=1)
)
_ENGINE_OPTIONS = (
    replace(_QUICK_OPTIONS, engine=Engine.GUILLOTINE),
    replace(_QUICK_OPTIONS, engine=Engine.PARALLELOBOX),
    replace(_QUICK_OPTIONS, engine=Engine.PARALLELOBOX, faithful=True),
    replace(_QUICK_OPTIONS, engine=Engine.SYMMETRY),
    replace(_QUICK_OPTIONS, engine=Engine.CUBE_SKELETON),
)


def compile_functions() -> None:
    """Compile every function for the argument types that decompositions use, and store the code.

    If several processes do this at the same time, the first one compiles and the others wait.
    """
    with ExitStack() as stack:
        if CODE_FOLDER is not None and not is_compiled():
            lock = stack.enter_context((CODE_FOLDER / "lock").open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        _cut_small_model()
        mark_compiled()


def ensure_compiled() -> None:
    """Compile every function, unless the code for this processor is stored already."""
    if not is_compiled():
        compile_functions()


def _cut_small_model() -> None:
    """Repair a ring that lacks triangles and has a loose triangle, and cut it with each engine."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "ring.stl"
        ring: Any = trimesh.creation.torus(60.0, 25.0, major_sections=24, minor_sections=12)
        sheet = np.array([[[0, 0, 0], [15, 0, 0], [0, 15, 0]]])
        write_stl(path, np.concatenate([ring.triangles[5:], sheet]).astype(np.float32))
        model = load_model(path)
        cost = CostModel.from_settings(PrintTimeSettings())
        for options in _ENGINE_OPTIONS:
            printers = [replace(_PRINTER, name=name) for name in "abcdefghij"]
            decomposition = decompose_model(model, printers, options, cost)
        write_decomposition(decomposition, Path(scratch) / "parts")
    # The engines above make no search for the least total print time, as their budget is spent, and may not
    # need to estimate prices again.
    numbers = np.arange(3)
    tables = BoxTables((2, 1, 1), numbers.astype(np.float32), numbers.astype(np.int32), np.ones(3, np.int16))
    LeastWorkSearch(tables).find_boxes((0.0, 2.0), 2)
    add_box_sums(tables.seconds, np.zeros((2, 1, 1)), tables.seconds.copy())


def main() -> None:
    """Compile all functions, and print the folder of the code."""
    ensure_compiled()
    place = "nowhere: no folder is writable" if CODE_FOLDER is None else f"in {CODE_FOLDER}"
    if CODE_FOLDER not in (None, INSTALLED_FOLDER):
        place += f", as {INSTALLED_FOLDER} is not writable"
    sys.stdout.write(f"Machine code is kept {place}\n")


if __name__ == "__main__":
    main()
