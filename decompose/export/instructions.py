"""Instructions for assembly: one HTML page that loads nothing, with a picture of each step."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from decompose.assembly import AssemblyStep
from decompose.export.picture import short_label
from decompose.export.step_picture import draw_steps
from decompose.results import Decomposition


@cache
def _templates() -> Environment:
    return Environment(loader=PackageLoader("decompose.export"), autoescape=True, undefined=StrictUndefined)


def write_instructions(decomposition: Decomposition, path: Path, overview: Path | None = None) -> None:
    """Draw all steps and write the page.

    Parameters
    ----------
    decomposition
        Its parts with their names.
    path
        File to write.
    overview
        PNG of the parts with their numbers.
    """
    page = render_instructions(
        decomposition, draw_steps(decomposition), None if overview is None else overview.read_bytes()
    )
    path.write_text(page, encoding="utf-8")


def render_instructions(
    decomposition: Decomposition, pictures: Sequence[bytes], overview: bytes | None
) -> str:
    """Render the page.

    Parameters
    ----------
    pictures
        PNG of each step, in order.
    overview
        PNG of the parts with their numbers.
    """
    assembly = decomposition.assembly
    steps = [
        _describe_step(number, step, decomposition, picture)
        for number, (step, picture) in enumerate(zip(assembly.steps, pictures, strict=True), 1)
    ]
    return (
        _templates()
        .get_template("instructions.html")
        .render(
            parts=_list_parts(decomposition),
            steps=steps,
            levels=assembly.levels,
            locked=[_name_parts(decomposition, group) for group in assembly.locked],
            overview=None if overview is None else _embed(overview),
        )
    )


def _list_parts(decomposition: Decomposition) -> list[dict[str, Any]]:
    """Describe each part, with the first step that uses it."""
    first: dict[int, int] = {}
    for number, step in enumerate(decomposition.assembly.steps, 1):
        for part in (*step.moved, *step.fixed):
            first.setdefault(part, number)
    rows = []
    for index, piece in enumerate(decomposition.parts):
        vertices, _ = piece.printing_mesh()
        size = " x ".join(f"{extent:.0f}" for extent in np.ptp(vertices, axis=0))
        volume = f"{piece.solid.volume_mm3 / 1000.0:.1f}"
        rows.append({"id": piece.id, "size": size, "volume": volume, "step": str(first.get(index, ""))})
    return rows


def _describe_step(
    number: int, step: AssemblyStep, decomposition: Decomposition, picture: bytes
) -> dict[str, Any]:
    joints = [decomposition.joints[joint] for joint in step.joints]
    min_mm2 = decomposition.options.min_glue_mm2
    rest = ", ".join(_name_parts(decomposition, step.rests_on))
    return {
        "number": number,
        "level": step.level,
        "picture": _embed(picture),
        "moved": ", ".join(_name_parts(decomposition, step.moved)),
        "fixed": ", ".join(_name_parts(decomposition, step.fixed)),
        "slides": step.slides,
        "support": (
            f"The other body stands on {rest}, with the joint upwards."
            if rest
            else "Hold the other body: it does not stand with the joint upwards."
        ),
        "joints": [
            {
                "name": "-".join(short_label(decomposition.parts[part].id) for part in (joint.a, joint.b)),
                "area": f"{joint.area_mm2:,.0f}",
                "weak": "" if joint.holds(min_mm2) else "holds nothing by itself",
            }
            for joint in joints
        ],
    }


def _name_parts(decomposition: Decomposition, numbers: Sequence[int]) -> list[str]:
    return [decomposition.parts[number].id for number in numbers]


def _embed(png: bytes) -> str:
    return "data:image/png;base64," + b64encode(png).decode("ascii")
