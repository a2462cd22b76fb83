"""What print time is made of, at a quality: seconds for each mm3, mm2 and layer, fitted on real slices.

Boxy parts like those that the decomposition makes (solid, hollow, with bridges and steps) are sliced with
CuraEngine, and a non-negative least-squares fit on relative errors gives a coefficient for each feature.
Beside each stands what the settings alone say: a line is as long as its area over its width, and takes its
length over its speed.

Run: ``python bench/slicing_time.py [--quality glue] [--json]``
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from scipy.optimize import nnls

from slicing.plate import PlateRequest, slice_plate
from slicing.resources import find_engine, find_resources
from slicing.settings import Settings, SettingsRequest, resolve_settings

BED = ((-111.5, -111.5, 111.5, 111.5, 205.0),)
FEATURES = ("volume_mm3", "lateral_mm2", "skin_mm2", "column_mm3", "brim_mm2", "layers", "fixed")


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    """A box that stands at a place of its lowest corner."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(np.array(at) + np.array(size) / 2)
    return mesh


def parts() -> dict[str, trimesh.Trimesh]:
    """About twenty parts, by name."""
    union, difference = trimesh.boolean.union, trimesh.boolean.difference
    made = {
        f"box {x}x{y}x{z}": box((x, y, z))
        for x, y, z in ((20, 20, 20), (80, 60, 10), (60, 60, 60), (30, 30, 120), (120, 15, 40), (100, 80, 30))
    }
    for width, wall in ((50, 3), (80, 5), (100, 8)):
        cavity = box((width - 2 * wall,) * 2 + (width,), (wall, wall, wall))
        made[f"cup {width} wall {wall}"] = difference([box((width, width, width)), cavity])
        made[f"bowl {width} wall {wall}, upside down"] = difference(
            [box((width, width, width)), box((width - 2 * wall,) * 2 + (width,), (wall, wall, -wall))]
        )
    for reach, lift in ((30, 20), (60, 40), (40, 80)):
        slab = box((20 + reach, 40, 12), (0, 0, lift))
        made[f"arm {reach} at {lift}"] = union([box((20, 40, lift + 12)), slab])
        made[f"bridge {reach} at {lift}"] = union(
            [
                box((15, 40, lift + 12)),
                box((15, 40, lift + 12), (15 + reach, 0, 0)),
                box((30 + reach, 40, 12), (0, 0, lift)),
            ]
        )
    made["stairs"] = union([box((80 - 20 * i, 50, 15 * (i + 1))) for i in range(4)])
    made["cylinder"] = trimesh.creation.cylinder(25, 50)
    made["ball"] = trimesh.creation.icosphere(3, 30)
    return made


def features(mesh: trimesh.Trimesh, settings: Settings, layers: int) -> list[float]:
    """In the order of FEATURES; needs no slicing but the number of layers."""
    normals, areas = mesh.face_normals, mesh.area_faces
    up = normals[:, 2]
    flat = np.abs(up) > math.cos(math.radians(47))
    lateral = float((areas * np.sqrt(np.clip(1 - up**2, 0, 1)))[~flat].sum())
    skin = float((areas * np.abs(up))[flat].sum())
    heights = mesh.triangles_center[:, 2] - mesh.bounds[0][2]
    hanging = (-up > math.sin(math.radians(settings.support_angle_deg))) & (heights > 0.1)
    column = float((areas * -up * heights)[hanging].sum()) if settings.support_enabled else 0.0
    footprint = mesh.triangles[(up < -0.99) & (heights < 0.1)]
    brim = 0.0
    if len(footprint):
        spans = np.ptp(footprint.reshape(-1, 3)[:, :2], axis=0)
        brim = float(2 * spans.sum() * settings.brim_width_mm + math.pi * settings.brim_width_mm**2)
    return [mesh.volume, lateral, skin, column, brim, layers, 1.0]


def by_settings(s: Settings) -> list[float | None]:
    """The same coefficients out of the settings; None where they say nothing."""
    line, layer = s.line_width_mm, s.layer_height_mm
    inner = max(0, s.wall_count - 1)
    infill = (
        1 / (layer * s.infill_line_distance_mm * s.speed_infill_mm_s) if s.infill_line_distance_mm else 0.0
    )
    support = (
        1 / (layer * s.support_line_distance_mm * s.speed_support_mm_s) if s.support_line_distance_mm else 0.0
    )
    return [
        infill,
        (1 / s.speed_wall_0_mm_s + inner / s.speed_wall_x_mm_s) / layer,
        (s.top_layers + s.bottom_layers) / 2 / (line * s.speed_topbottom_mm_s),
        support,
        1 / (line * s.speed_layer_0_mm_s),
        None,
        None,
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quality", default="glue")
    parser.add_argument("--json", action="store_true", help="one object on stdout")
    options = parser.parse_args()
    settings = resolve_settings(SettingsRequest("ultimaker2_plus", options.quality), find_resources())
    rows, times, names = [], [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for title, mesh in parts().items():
            centre = mesh.bounds.mean(axis=0)
            mesh.apply_translation(-np.array([centre[0], centre[1], mesh.bounds[0][2]]))
            stl = folder / "part.stl"
            mesh.export(stl)
            result = slice_plate(PlateRequest(stl, settings, folder / "part.gcode", find_engine(), BED))
            rows.append(features(mesh, settings, result.layers))
            times.append(result.print_time_s)
            names.append(title)
    matrix, measured = np.array(rows), np.array(times)
    scale = (matrix / measured[:, None]).max(axis=0)  # so that no feature is too small for the solver
    fitted = nnls(matrix / measured[:, None] / scale, np.ones(len(measured)))[0] / scale
    errors = matrix @ fitted / measured - 1
    report = {
        "schema": 1,
        "quality": options.quality,
        "parts": len(names),
        "seconds_per": dict(zip(FEATURES, map(float, fitted), strict=True)),
        "by_settings": dict(zip(FEATURES, by_settings(settings), strict=True)),
        "mean_error": float(np.abs(errors).mean()),
        "worst_error": float(np.abs(errors).max()),
        "errors": {title: [float(t), float(e)] for title, t, e in zip(names, measured, errors, strict=True)},
    }
    if options.json:
        print(json.dumps(report))
        return
    print(
        f"{options.quality}: {len(names)} parts, mean error {report['mean_error']:.1%}, "
        f"worst {report['worst_error']:.1%}"
    )
    for feature, value, said in zip(FEATURES, fitted, by_settings(settings), strict=True):
        print(f"  {feature:12} {value:10.5f} s" + (f"   settings say {said:.5f}" if said is not None else ""))
    for title, (seconds, error) in report["errors"].items():
        print(f"  {title:28} {seconds:8.0f} s {error:+7.1%}")


if __name__ == "__main__":
    main()
