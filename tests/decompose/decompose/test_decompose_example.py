"""Model of the demo, which is too large for one printer, light, closed and deterministic."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from decompose.decompose import decompose_model
from decompose.geometry import load_model
from decompose.options import BestOptions, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter

ROOT = Path(__file__).parents[3]


def run_script(*args: str) -> subprocess.CompletedProcess[str]:
    script = ROOT / "examples" / "make_aqueduct.py"
    return subprocess.run(
        [sys.executable, str(script), *args],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={"PYTHONPATH": "."},
    )


def test_aqueduct_of_the_paper_is_cut(tmp_path: Path, fleet: list[TargetPrinter], cost: CostModel) -> None:
    first_path, second_path = tmp_path / "a.stl", tmp_path / "b.stl"
    process = run_script(str(first_path))
    assert process.returncode == 0, process.stderr
    assert "330 x" in process.stdout
    run_script(str(second_path))
    assert first_path.read_bytes() == second_path.read_bytes()
    model = load_model(first_path)
    assert model.repairs == ()
    assert model.extents_mm[0] == pytest.approx(330.0)
    assert model.solid.volume_mm3 < 800_000.0
    assert not any(p.fits(*model.extents_mm) for p in fleet)
    result = decompose_model(model, fleet, Options(best=BestOptions(0.0), prove=False), cost)
    assert len(result.parts) == 8
    assert result.serial_s / result.makespan_s > 6.0


def test_unwritable_output_folder_is_refused(tmp_path: Path) -> None:
    assert run_script().returncode == 2
    assert "usage" in run_script("--help").stdout
    assert not (ROOT / "--help").exists()
    process = run_script(str(tmp_path / "no" / "such" / "folder.stl"))
    assert process.returncode == 1
    assert len(process.stderr.splitlines()) == 1
