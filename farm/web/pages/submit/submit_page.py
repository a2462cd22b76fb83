"""Page with the form that submits a model. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from decompose.files.extras import can_read_step
from decompose.options import MAX_PIN_MM, MIN_PIN_MM
from drivers.printers import PROFILES
from farm.config import Fleet, PrinterSection
from farm.text import format_count
from farm.web.notes import Note, Reader
from farm.web.pages.rendering import FleetInfo, render_page
from farm.web.pages.submit.options import DEFAULTS, QUALITIES, UNITS

SUBMIT_PATH = "/submit"
_MESH_SUFFIXES, _GCODE_SUFFIXES = ".stl,.3mf,.obj,.ply,.off", ".gcode,.gco,.g"
_STEP_SUFFIXES = ".step,.stp"


@dataclass(frozen=True, slots=True)
class SubmitChoices:
    """Choices in the form, from the printers of the fleet.

    Attributes
    ----------
    printer_count
        Number of printers.
    materials, colours
        Kinds of material, and colours, on the printers.
    build_volumes_mm
        Build volumes: name of the printer model, width, depth and height.
    timezone
        Time zone of the times in the form.
    can_read_step
        True if the package for STEP files is installed.
    """

    printer_count: int
    materials: Sequence[str]
    colours: Sequence[str]
    build_volumes_mm: Sequence[tuple[str, float, float, float]]
    timezone: str
    can_read_step: bool = False


def list_choices(fleet: Fleet) -> SubmitChoices:
    """List the materials, colours and build volumes of the enabled printers, each once."""
    printers = [printer for printer in fleet.printers if printer.enabled]
    beds = {_describe_build_volume(printer) for printer in printers if printer.model in PROFILES}
    return SubmitChoices(
        printer_count=len(printers),
        materials=sorted({printer.material_kind or printer.material for printer in printers}),
        colours=sorted({printer.colour for printer in printers if printer.colour}),
        build_volumes_mm=sorted(beds),
        timezone=fleet.fleet.timezone,
        can_read_step=can_read_step(),
    )


def _describe_build_volume(section: PrinterSection) -> tuple[str, float, float, float]:
    profile = PROFILES[section.model]
    return profile.title, *(section.volume_mm or (*profile.bed_mm, profile.height_mm))


def render_submit_page(
    choices: SubmitChoices,
    request_id: str,
    fleet: FleetInfo,
    reader: Reader,
    note: Note | None = None,
    values: Mapping[str, str] = DEFAULTS,
) -> str:
    """Render the page.

    Parameters
    ----------
    choices
        Choices in the form.
    request_id
        Id of the submission; a form that is sent twice makes one job.
    fleet, reader, note
        See `render_page`.
    values
        Values of the fields.
    """
    return render_page(
        "submit.html",
        fleet,
        SUBMIT_PATH,
        reader,
        note,
        choices=choices,
        fleet_size=format_count(choices.printer_count, "printer"),
        request_id=request_id,
        values={**DEFAULTS, **values},
        units=UNITS,
        qualities=QUALITIES,
        min_pin_mm=MIN_PIN_MM,
        max_pin_mm=MAX_PIN_MM,
        beds=json.dumps([list(bed) for bed in choices.build_volumes_mm]),
        file_types=",".join(
            (_MESH_SUFFIXES, *([_STEP_SUFFIXES] if choices.can_read_step else []), _GCODE_SUFFIXES)
        ),
    )
