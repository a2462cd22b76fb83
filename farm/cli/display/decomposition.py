"""Summary of a decomposition, as `farm decompose` prints it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from farm.text import format_count, format_duration
from farm.wording import format_filament


def summarise_decomposition(report: dict[str, Any], printer_count: int, out: Path) -> list[str]:
    """Summarise a decomposition in at most nine lines.

    Parameters
    ----------
    report
        The report, as `--json` prints it.
    printer_count
        The number of printers.
    out
        The folder with its files.

    Returns
    -------
    list of str
        The lines. One of them has two printing times of the uncut model on a large printer: in the best pose,
        and in the pose of the file. The efficiency E is defined as in the paper: the time in the pose of the
        file, divided by the product of the number of printers and the makespan.
    """
    parts = report["parts"]
    part_range = f"{parts[0]['file']} to {parts[-1]['file']}" if len(parts) > 1 else parts[0]["file"]
    return [
        *([" ".join(report["repairs"])] if report["repairs"] else []),
        *_summarise_times(report, printer_count),
        *_summarise_assembly(report),
        *_summarise_warnings(report),
        f"In {out}: {part_range}, assembly.png, assembly.glb, decomposition.json, instructions.html",
    ]


def _summarise_times(report: dict[str, Any], printer_count: int) -> list[str]:
    parts, makespan_s = report["parts"], report["makespan_s"]
    best_pose_s, file_pose_s = report["serial_s"], report["serial_as_is_s"]
    efficiency = file_pose_s / (printer_count * makespan_s)
    lines = [
        f"{format_count(len(parts), 'part')}: {format_duration(makespan_s)} on "
        f"{format_count(printer_count, 'printer')}; uncut on a large one: {format_duration(best_pose_s)} in "
        f"the best pose, {format_duration(file_pose_s)} as in the file (efficiency E {efficiency:.2f})"
    ]
    if "sliced_makespan_s" in report:
        slowest = max(parts, key=lambda part: float(part["sliced_s"]))
        amount = format_filament(*(sum(part[key] for part in parts) for key in ("grams", "filament_mm")))
        lines.append(
            f"Sliced: {format_duration(report['sliced_makespan_s'])} to the end of {slowest['id']}, the "
            f"slowest; {amount}"
        )
    rotation = f", turned by {report['yaw_deg']:.0f} degrees about Z" if report["yaw_deg"] else ""
    # The bound is below the least makespan, so the gap to the least makespan is at most the gap to the bound.
    optimum = "least makespan with cuts along its grid" if report["cells"] else "least possible makespan"
    gap = f"at most {report['gap']:.0%} above the {optimum}"
    any_boxes_bound_s = report.get("any_boxes_bound_s")
    bound_note = (
        f", {makespan_s / any_boxes_bound_s - 1.0:.0%} above the lower bound for cuts into any boxes"
        if any_boxes_bound_s
        else ""
    )
    return [*lines, f"By {report['engine']}{rotation}: {gap}{bound_note}"]


def _summarise_assembly(report: dict[str, Any]) -> list[str]:
    lines = []
    glued_joints = [joint for joint in report["joints"] if joint["glued"]]
    if glued_joints:
        smallest = min(glued_joints, key=lambda joint: float(joint["area_mm2"]))
        lines.append(
            f"{format_count(len(glued_joints), 'joint')}; the smallest, {smallest['a']} to {smallest['b']}, "
            f"has {smallest['area_mm2']:.0f} mm2 of glue area and is {smallest['width_mm']:.1f} mm wide"
        )
    steps = report["assembly"]["steps"]
    if steps:
        duration = format_duration(report["assembly"]["estimated_s"])
        assembly = f"{format_count(len(steps), 'step')} of assembly, about {duration}"
        lines.append(f"{assembly}; {report['seam_mm']:.0f} mm of joint lines on the outside")
    connectors = report["connectors"]
    cuts_by_diameter_mm: dict[float, list[dict[str, Any]]] = {}
    for cut in connectors["cut_list"]:
        cuts_by_diameter_mm.setdefault(cut.get("diameter_mm", report["options"]["pin_mm"]), []).append(cut)
    for diameter_mm, cuts in cuts_by_diameter_mm.items():
        lengths = ", ".join(f"{cut['count']} of {cut['length_mm']:g} mm" for cut in cuts)
        count = format_count(sum(cut["count"] for cut in cuts), "pin")
        lines.append(f"{count} of {diameter_mm:g} mm: cut {lengths}")
    return lines


def _summarise_warnings(report: dict[str, Any]) -> list[str]:
    """Join the first three warnings into one line; return no line if there are no warnings."""
    unstable_parts = [part["id"] for part in report["parts"] if not part["stands"]]
    warnings = [
        *(f"{fault['part']} {fault['what']}" for fault in report["faults"]),
        *(f"{part} may fall over while it is printed" for part in unstable_parts),
        *report["connectors"]["failures"],
        *(text for text in (report["thin_rims"], report["small_feet"]) if text),
    ]
    if not warnings:
        return []
    others = f", and {len(warnings) - 3} more" if len(warnings) > 3 else ""
    return [f"Check: {'; '.join(warnings[:3])}{others}"]
