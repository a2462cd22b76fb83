"""Instructions for assembly: one HTML page that loads no other files, with a picture of each step."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from decompose.assembly import AssemblyStep
from decompose.export.connector_rows import (
    explain_pins,
    list_mark_texts,
    list_pins,
    list_unglued_mark_texts,
    list_unmarked_parts,
)
from decompose.export.layout import describe_place, draw_layout, name_printer, sort_parts_by_use
from decompose.export.page_check import find_page_faults
from decompose.export.pin_sheet import make_pin_sheet
from decompose.export.step_picture import StepPictures, draw_steps
from decompose.files.names import find_part_number
from decompose.printers import BedPlace
from decompose.results import Decomposition

_TEMPLATE = Environment(
    loader=PackageLoader("decompose.export"), autoescape=True, undefined=StrictUndefined
).get_template("instructions.html")
"""Template; it is read on import, because an update may replace its file while a worker runs."""


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures of a page, as PNG.

    Attributes
    ----------
    steps
        Pictures of each step.
    overview, layout
        All parts in an exploded view, and all parts on their beds; None if there is no such picture.
    places
        Place of each part on its bed; empty if no place is known.
    """

    steps: Sequence[StepPictures] = ()
    overview: bytes | None = None
    layout: bytes | None = None
    places: tuple[BedPlace | None, ...] = ()


def write_instructions(
    decomposition: Decomposition,
    path: Path,
    overview: Path | None = None,
    places: Sequence[BedPlace | None] = (),
    steps: Sequence[StepPictures] | None = None,
) -> None:
    """Draw the steps, unless their pictures are given, and write the page.

    Parameters
    ----------
    decomposition
        Decomposition whose parts have their names.
    path
        File to write.
    overview
        PNG of the parts with their numbers.
    places
        Place of each part on its bed, None if it is not known; empty if no place is known.
    steps
        Pictures of all steps; None to draw them.
    """
    pictures = Pictures(
        draw_steps(decomposition) if steps is None else steps,
        None if overview is None else overview.read_bytes(),
        draw_layout(decomposition.parts, _order_parts(decomposition), places),
        tuple(places),
    )
    page = render_instructions(decomposition, pictures)
    faults = find_page_faults(page, decomposition)
    if faults:
        page = render_instructions(decomposition, pictures, faults)
    path.write_text(page, encoding="utf-8")


def render_instructions(decomposition: Decomposition, pictures: Pictures, faults: Sequence[str] = ()) -> str:
    """Render the page.

    Parameters
    ----------
    decomposition
        Decomposition whose parts have their names.
    pictures
        Pictures of its steps and parts.
    faults
        Faults of the page itself (`find_page_faults`), which the page shows first.

    Returns
    -------
    str
        HTML.
    """
    assembly = decomposition.assembly
    steps = [
        _describe_step(number, step, decomposition, step_pictures)
        for number, (step, step_pictures) in enumerate(zip(assembly.steps, pictures.steps, strict=True), 1)
    ]
    return _TEMPLATE.render(
        parts=_describe_parts(decomposition, pictures.places),
        steps=steps,
        levels=assembly.level_count,
        locked=[_name_parts(decomposition, group) for group in assembly.locked_sets],
        overview=_embed_png(pictures.overview),
        layout=_embed_png(pictures.layout),
        minutes=_format_minutes(assembly.total_s),
        least_minutes=_format_minutes(assembly.critical_path_s),
        seam_mm=f"{decomposition.sum_seams_mm():,.0f}",
        thin_rims=decomposition.describe_thin_rims(),
        sheet=make_pin_sheet(decomposition.connectors.pins),
        has_marks=bool(decomposition.connectors.marks),
        unglued_marks=list_unglued_mark_texts(decomposition),
        failures=decomposition.connectors.failures,
        faults=faults,
    )


def _order_parts(decomposition: Decomposition) -> list[int]:
    """List the numbers of all parts in the order of use."""
    return sort_parts_by_use(decomposition.parts, decomposition.assembly.part_order)


def _describe_parts(decomposition: Decomposition, places: Sequence[BedPlace | None]) -> list[dict[str, Any]]:
    """Describe each part in the order of use, with the first step that uses it."""
    first_steps: dict[int, int] = {}
    for number, step in enumerate(decomposition.assembly.steps, 1):
        for part_number in (*step.moved_parts, *step.fixed_parts):
            first_steps.setdefault(part_number, number)
    rows = []
    for index in _order_parts(decomposition):
        part = decomposition.parts[index]
        vertices, _ = part.build_printing_mesh()
        rows.append(
            {
                "id": part.id,
                "printer": name_printer(part),
                "place": describe_place(places[index] if places else None),
                "size": " x ".join(f"{extent_mm:.0f}" for extent_mm in np.ptp(vertices, axis=0)),
                "volume": f"{part.solid.volume_mm3 / 1000.0:.1f}",
                "step": str(first_steps.get(index, "")),
            }
        )
    return rows


def _describe_step(
    number: int, step: AssemblyStep, decomposition: Decomposition, step_pictures: StepPictures
) -> dict[str, Any]:
    """Build the variables of the template for a step."""
    fixed = ", ".join(_name_parts(decomposition, step.fixed_parts))
    resting_parts = ", ".join(_name_parts(decomposition, step.rests_on))
    return {
        "number": number,
        "level": step.level,
        "picture": _embed_png(step_pictures.both_bodies),
        "turned_over": _embed_png(step_pictures.moved_body),
        "top": step_pictures.top_direction,
        "moved": ", ".join(_name_parts(decomposition, step.moved_parts)),
        "fixed": fixed,
        "slides": step.slides,
        "minutes": _format_minutes(step.work_s),
        "seam_mm": f"{decomposition.sum_seams_mm(step.joints if decomposition.seams else ()):,.0f}",
        "support": (
            f"Put {fixed} down as drawn, on the grey table: with the joint upwards it stands"
            + (f" on {resting_parts}." if len(step.fixed_parts) > 1 else ".")
            if resting_parts
            else f"Hold {fixed} as drawn: it does not stand with the joint upwards."
        ),
        "pins": explain_pins(decomposition, number - 1) if step.joints else "",
        "joints": [_describe_joint(joint, decomposition) for joint in step.joints],
    }


def _describe_joint(number: int, decomposition: Decomposition) -> dict[str, Any]:
    """Build the variables of the template for a joint."""
    joint = decomposition.joints[number]
    ids = _name_parts(decomposition, (joint.a, joint.b))
    return {
        "parts": " ".join(ids),
        "name": "-".join(map(find_part_number, ids)),
        "area": f"{joint.area_mm2:,.0f}",
        "weak": "" if joint.holds(decomposition.options.min_glue_mm2) else "does not hold by itself",
        "marks": list_mark_texts(decomposition, number),
        "unmarked_parts": list_unmarked_parts(decomposition, number),
        "pins": list_pins(decomposition, number),
    }


def _format_minutes(seconds: float) -> str:
    """Format a time in whole minutes, at least one."""
    return f"{max(1.0, seconds / 60.0):.0f}"


def _name_parts(decomposition: Decomposition, numbers: Sequence[int]) -> list[str]:
    """List the names of parts by their numbers."""
    return [decomposition.parts[number].id for number in numbers]


def _embed_png(png: bytes | None) -> str | None:
    """Encode a picture as a data URL."""
    return None if png is None else "data:image/png;base64," + b64encode(png).decode("ascii")
