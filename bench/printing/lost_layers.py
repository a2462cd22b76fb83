"""Acceptance of complete slices, and refusal of slices with missing layers.

``python -m bench.printing.lost_layers [STL ...] [--cuts N] [--seed N] [--keep FOLDER] [--raw] [--json]``

CuraEngine slices generated models and those of the STL files with several settings (UltiGCode, relative E,
rafts, spirals and others). Each file is read complete, and with layers removed in several ways. ``--keep``
stores the slices in a folder, and reads them from there the next time.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path

import trimesh

from bench.printing.slice_check import MOVE, make_models
from drivers.printers import SLICING_PROFILES
from farm.planning.printer_settings import build_slicing_printer
from slicing.checks.output import replace_header
from slicing.engine import EngineLimits, run_engine
from slicing.errors import EngineFailed, GcodeRefused
from slicing.own_gcode import PrintTarget, accept_gcode
from slicing.settings import EngineSettings, SettingsRequest, find_engine, find_resources, resolve_settings
from slicing.settings.limits import find_reserved_reason

_ULTIGCODE = {
    "machine_gcode_flavor": "UltiGCode",
    "machine_firmware_retract": "True",
    "machine_start_gcode": "",
    "machine_end_gcode": "",
}
SLICE_SETTINGS: dict[str, dict[str, str]] = {
    "plain": {},
    "ultigcode": _ULTIGCODE,
    "ultigcode raft": {**_ULTIGCODE, "adhesion_type": "raft"},
    "ultigcode supports": {**_ULTIGCODE, "support_enable": "True", "support_structure": "normal"},
    "ultigcode spiral": {**_ULTIGCODE, "magic_spiralize": "True"},
    "relative": {"relative_extrusion": "True"},
    "relative supports": {"relative_extrusion": "True", "support_enable": "True"},
    "raft": {"adhesion_type": "raft"},
    "tree supports": {"support_enable": "True", "support_structure": "tree"},
    "spiral": {"magic_spiralize": "True"},
    "adaptive": {"adaptive_layer_height_enabled": "True"},
    "coasting": {"coasting_enable": "True", "retraction_hop_enabled": "True"},
    "primed": {"retraction_extra_prime_amount": "0.2", "retraction_hop_enabled": "True"},
    "unretracted": {"retraction_enable": "False", "retraction_combing": "off"},
    "ironed": {"ironing_enabled": "True", "bridge_settings_enabled": "True"},
    "fuzzy": {"magic_fuzzy_skin_enabled": "True", "infill_sparse_thickness": "0.4"},
    "surface": {"magic_mesh_surface_mode": "surface"},
    "fine": {"layer_height": "0.1", "infill_pattern": "lightning"},
}
"""Settings of CuraEngine, in addition to those of the quality."""
_SIZE_MM = 22.0
"""Longest side of a model, which gives enough layers and a short slicing time."""
_LAYER = re.compile(rb"(?m)^;LAYER:(-?\d+)\r?\n")
_EXTRUDING_MOVE = re.compile(rb"(?m)^G1[^\n]* [XY][^\n]* E")
_END = re.compile(rb"(?m)^;TIME_ELAPSED:[^\n]*\n")

Cut = Callable[[list[bytes], random.Random], list[bytes]]
"""Function that removes layers from a list of all layers."""


def _cut_first_layers(layers: list[bytes], rng: random.Random) -> list[bytes]:
    return layers[rng.randint(1, max(1, len(layers) // 2)) :]


def _cut_one_layer(layers: list[bytes], rng: random.Random) -> list[bytes]:
    index = rng.randrange(1, len(layers) - 1)
    return layers[:index] + layers[index + 1 :]


def _cut_consecutive_layers(layers: list[bytes], rng: random.Random) -> list[bytes]:
    first_layer = rng.randrange(1, len(layers) - 1)
    return layers[:first_layer] + layers[rng.randrange(first_layer, len(layers) - 1) + 1 :]


def _cut_many_layers(layers: list[bytes], rng: random.Random) -> list[bytes]:
    indices = set(rng.sample(range(len(layers)), rng.randint(2, max(2, len(layers) // 3))))
    return [layer for index, layer in enumerate(layers) if index not in indices]


def _cut_last_layers(layers: list[bytes], rng: random.Random) -> list[bytes]:
    return layers[: -rng.randint(1, max(1, len(layers) // 3))]


def _cut_lines(layers: list[bytes], rng: random.Random) -> list[bytes]:
    """Remove the lines between two random positions."""
    lines = b"".join(layers).splitlines(keepends=True)
    start, stop = sorted(rng.sample(range(1, len(lines) - 1), 2))
    return [*lines[:start], *lines[min(stop, start + rng.choice((150, len(lines)))) :]]


CUTS: dict[str, Cut] = {
    "first": _cut_first_layers,
    "one": _cut_one_layer,
    "run": _cut_consecutive_layers,
    "many": _cut_many_layers,
    "last": _cut_last_layers,
    "torn": _cut_lines,
}


class ZeroTimeEstimator:
    """Estimator that always returns 0, because acceptance does not depend on it."""

    def move(self, x: float, y: float, z: float, e: float, speed_mm_s: float) -> None:
        """Ignore a move."""

    def wait(self, seconds: float) -> None:
        """Ignore a wait."""

    def measure_time_s(self, finish: bool = False) -> float:
        """Return 0."""
        return 0.0


class Slicer:
    """CuraEngine with the settings of an Ultimaker 2+, and the print target of its files."""

    def __init__(self, raw: bool) -> None:
        self._resources = find_resources()
        self._raw = raw
        settings = self._resolve({})
        self.target = PrintTarget(
            settings.printer, settings.filament_mm2, 0.4, settings.nozzle_c, settings.bed_c
        )

    def slice_model(self, mesh: trimesh.Trimesh, overrides: dict[str, str]) -> bytes:
        """Scale and centre a model, and slice it; return empty bytes if the engine fails."""
        mesh = mesh.copy()
        mesh.apply_scale(min(1.0, _SIZE_MM / max(mesh.extents)))
        low_mm, high_mm = mesh.bounds
        mesh.apply_translation((-(low_mm[0] + high_mm[0]) / 2, -(low_mm[1] + high_mm[1]) / 2, -low_mm[2]))
        locked_settings = {
            key: value for key, value in overrides.items() if find_reserved_reason(key) or value == "raft"
        }
        settings = self._resolve(
            {key: value for key, value in overrides.items() if key not in locked_settings}
        )
        with tempfile.TemporaryDirectory() as folder:
            stl = Path(folder) / "model.stl"
            mesh.export(stl)
            stacks = {**settings.global_, **locked_settings}, {**settings.extruder, **locked_settings}
            try:
                output = run_engine(find_engine(), stl, *stacks, EngineLimits(1000, 300.0))
            except EngineFailed:
                return b""
        return output.gcode if self._raw else replace_header(output.gcode, output.log, sliced_s=0.0)

    def _resolve(self, overrides: dict[str, str]) -> EngineSettings:
        printer = build_slicing_printer(SLICING_PROFILES["ultimaker2_plus"])
        return resolve_settings(
            SettingsRequest(printer, "glue", "generic_pla", 0.4, overrides), self._resources
        )


def make_more_models() -> dict[str, trimesh.Trimesh]:
    """Make models with tips, gaps between layers, and thin tops."""
    create = trimesh.creation
    ball = create.icosphere(3, 10, transform=MOVE((0, 0, 30)))
    pin = create.cylinder(3, 20, transform=MOVE((0, 0, 10)))
    return {
        "spire": create.cone(3, 40),
        "ball above a pin": trimesh.util.concatenate([pin, ball]),
        "two heights": trimesh.util.concatenate([create.box((9, 9, 20), MOVE((-8, 0, 10))), pin]),
        "table": trimesh.boolean.union([create.box((30, 30, 3), MOVE((0, 0, 25))), create.cylinder(2, 48)]),
        "hourglass": trimesh.boolean.union(
            [create.cone(10, 20), create.cone(10, 20, transform=MOVE((0, 0, 30)) @ _HALF_TURN)]
        ),
        "slab": create.box((22, 15, 1)),
        "above a slab": trimesh.util.concatenate(
            [create.box((20, 20, 3), MOVE((0, 0, 1.5))), create.box((12, 12, 3), MOVE((0, 0, 10)))]
        ),
        "apart": trimesh.util.concatenate(
            [create.cylinder(8, 5, transform=MOVE((0, 0, z))) for z in (2.5, 9.1)]
        ),
    }


_HALF_TURN = trimesh.transformations.rotation_matrix(3.14159265, (1, 0, 0))


def split_layers(gcode: bytes) -> tuple[bytes, list[bytes], bytes]:
    """Split a file into its head, its layers, and the rest."""
    starts = [match.start() for match in _LAYER.finditer(gcode)]
    end = [match.end() for match in _END.finditer(gcode)][-1]
    bounds = [*starts, end]
    layers = [gcode[a:b] for a, b in pairwise(bounds)]
    return gcode[: starts[0]], layers, gcode[end:]


def find_refusal(gcode: bytes, target: PrintTarget) -> str | None:
    """Read a file; return the reason for its refusal, or None if it is accepted."""
    try:
        accept_gcode(gcode.splitlines(keepends=True), target, time_estimator=ZeroTimeEstimator())
    except GcodeRefused as refused:
        return str(refused)
    return None


def list_slices(
    models: dict[str, trimesh.Trimesh], slicer: Slicer, folder: Path
) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the G-code of each slice with more than three layers."""
    for name, mesh in models.items():
        for variant, settings in SLICE_SETTINGS.items():
            title = f"{Path(name).stem}, {variant}"
            path = folder / f"{title}.gcode"
            if not path.exists():
                path.write_bytes(slicer.slice_model(mesh, settings))
            gcode = path.read_bytes()
            if len(_LAYER.findall(gcode)) > 3:
                yield title, gcode


@dataclass
class Findings:
    """Numbers of complete files, and of damaged files by kind of cut; titles of files judged wrongly."""

    whole: int = 0
    cut: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    false_alarms: list[str] = field(default_factory=list)
    undetected: list[str] = field(default_factory=list)

    def read_slice(
        self, title: str, gcode: bytes, target: PrintTarget, cuts: int, rng: random.Random
    ) -> None:
        """Read a complete file, then copies of it with layers removed by each kind of cut."""
        self.whole += 1
        if (reason := find_refusal(gcode, target)) is not None:
            self.false_alarms.append(f"{title}: {reason}")
            return
        head, layers, end = split_layers(gcode)
        for kind, cut in CUTS.items():
            for _ in range(cuts):
                remaining_layers = cut(layers, rng)
                if len(_EXTRUDING_MOVE.findall(b"".join(remaining_layers))) == len(
                    _EXTRUDING_MOVE.findall(b"".join(layers))
                ):
                    continue
                self.cut[kind] += 1
                if find_refusal(head + b"".join(remaining_layers) + end, target) is not None:
                    self.refused[kind] += 1
                else:
                    lost_numbers = (
                        _LAYER.findall(layer) for layer in layers if layer not in remaining_layers
                    )
                    numbers = ", ".join(number[0].decode() for number in lost_numbers)
                    self.undetected.append(f"{title}: {kind}, {len(layers)} layers without {numbers[:40]}")


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stl", nargs="*", type=Path)
    parser.add_argument("--cuts", type=int, default=1, help="cuts of each kind in each slice")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder in which the slices are kept")
    parser.add_argument("--raw", action="store_true", help="keep CuraEngine's placeholders in the header")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    models = {**make_models(), **make_more_models()}
    models |= {str(path): trimesh.load_mesh(path) for path in options.stl}
    slicer, rng, findings = Slicer(options.raw), random.Random(options.seed), Findings()
    with tempfile.TemporaryDirectory() as name:
        folder = options.keep or Path(name)
        folder.mkdir(exist_ok=True)
        for title, gcode in list_slices(models, slicer, folder):
            findings.read_slice(title, gcode, slicer.target, options.cuts, rng)
    if options.json:
        print(json.dumps({"schema": 1, **asdict(findings)}, indent=1))
        return
    accepted_count = findings.whole - len(findings.false_alarms)
    print(f"whole: {findings.whole}, {accepted_count} accepted", *findings.false_alarms, sep="\n  ")
    for kind, count in findings.cut.items():
        print(f"{kind}: {count} files, {findings.refused[kind]} refused")
    refused_count = findings.refused.total()
    print(f"all: {findings.cut.total()} files, {refused_count} refused", *findings.undetected, sep="\n  ")


if __name__ == "__main__":
    main()
