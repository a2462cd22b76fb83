"""Compilation ahead of time, after which a decomposition compiles no function."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CHECK_SCRIPT = """
import sys
from pathlib import Path

import numpy as np
import trimesh
from numba.core.dispatcher import Dispatcher

from decompose.compilation import compile_functions
from decompose.decompose import decompose_model
from decompose.export import write_decomposition
from decompose.geometry import load_model
from decompose.options import BestOptions, Engine, Interior, Options
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter


def list_signatures():
    for name, module in tuple(sys.modules.items()):
        for function in vars(module).values() if name.startswith("decompose.") else ():
            if isinstance(function, Dispatcher):
                yield from (
                    f"{function.__module__}.{function.__name__}{types}"
                    for types in function.signatures
                )


compile_functions()
old_signatures = set(list_signatures())
assert len(old_signatures) > 15
folder = Path(sys.argv[1])
torus = trimesh.creation.torus(90.0, 30.0)
cross = trimesh.util.concatenate([trimesh.creation.box(size) for size in ((200, 60, 60), (60, 200, 60))])
cross.update_faces(np.arange(len(cross.faces)) != 7)
printers = [TargetPrinter(f"{n}", ((120.0, 120.0, 110.0 + n % 2),)) for n in range(9)]
for name, mesh, options in (
    ("cross", cross, Options(granularity=8, best=BestOptions(0.0), interior=Interior.KEEP)),
    ("torus", torus, Options(engine=Engine.GUILLOTINE, granularity=8, seed=1)),
    ("thorough", torus, Options(granularity=8, best=BestOptions(2.0))),
):
    mesh.export(folder / f"{name}.stl")
    model = load_model(folder / f"{name}.stl")
    result = decompose_model(model, printers, options, CostModel.from_settings(PrintTimeSettings()))
    write_decomposition(result, folder / name)
print(sorted(set(list_signatures()) - old_signatures))
"""


def test_decomposition_compiles_no_further_function(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-c", CHECK_SCRIPT, tmp_path], capture_output=True, text=True, check=False
    )
    assert (process.stdout, process.returncode) == ("[]\n", 0), process.stderr
