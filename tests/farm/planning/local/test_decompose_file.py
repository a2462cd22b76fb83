"""`farm decompose`: the options that choose an engine."""

from __future__ import annotations

import json

import pytest
import trimesh

from decompose.options import ConnectorOptions
from farm.errors import FarmError
from farm.planning.local.decompose_file import DecomposeRequest, decompose_to_folder

USUAL_OPTIONS = {
    "printer_count": 4,
    "volume_mm": (223.0, 223.0, 205.0),
    "brim_mm": 8.0,
    "longest_side_mm": None,
    "scale": None,
    "granularity": "vcoarse",
    "interior": "leave",
    "min_wall_mm": 10.0,
    "min_glue_mm2": 25.0,
    "engine": "guillotine",
    "seed": 0,
    "attempt_count": 2,
    "score": "low",
    "is_faithful": False,
    "budget_s": 20.0,
    "clearing_s": 120.0,
    "assembly_s": 216.0,
}


@pytest.fixture
def bar(tmp_path):
    path = tmp_path / "bar.stl"
    trimesh.creation.box((260.0, 24.0, 32.0)).export(path)
    return path


def test_engine_is_selected_by_name(bar, tmp_path):
    path = tmp_path / "out"
    engine_options = {"engine": "parallelobox", "is_faithful": True, "score": "both"}
    report = decompose_to_folder(bar, path, DecomposeRequest(**USUAL_OPTIONS | engine_options))
    assert report["engine"] == "parallelobox"
    assert report["options"]["score"] == "high"
    assert 2 <= len(report["parts"]) <= 4
    assert json.loads((path / "decomposition.json").read_text())["options"]["faithful"] is True
    assert all((path / part["file"]).is_file() for part in report["parts"])


@pytest.mark.parametrize(
    ("wrong_option", "message"),
    [
        (
            {"engine": "saw"},
            "--engine saw: use one of best, guillotine, parallelobox, symmetry, cube-skeleton",
        ),
        ({"engine": "parallelobox", "score": "up"}, "--score up: use low, high or both"),
        (
            {"engine": "parallelobox", "is_faithful": True, "connectors": ConnectorOptions(2.85)},
            "--faithful cannot be combined with --pins or --marks",
        ),
        ({"interior": "gone"}, "--interior gone: use leave or keep"),
        ({"is_faithful": True}, "--faithful is for the engines of papers, not guillotine"),
    ],
)
def test_invalid_option_is_named(bar, tmp_path, wrong_option, message):
    with pytest.raises(FarmError, match=message):
        decompose_to_folder(bar, tmp_path / "out", DecomposeRequest(**USUAL_OPTIONS | wrong_option))
    assert not (tmp_path / "out").exists()


def test_refusal_names_a_size_that_fits(bar, tmp_path):
    options = USUAL_OPTIONS | {"printer_count": 1, "granularity": 3}
    with pytest.raises(FarmError, match=r"--longest-side \d+ was tried, and fits") as error:
        decompose_to_folder(bar, tmp_path / "out", DecomposeRequest(**options))
    side_mm = float(str(error.value).split("(--longest-side ")[1].split()[0])
    report = decompose_to_folder(
        bar, tmp_path / "out", DecomposeRequest(**options | {"longest_side_mm": side_mm})
    )
    assert len(report["parts"]) == 1
