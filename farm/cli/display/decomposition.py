"""The summary that `farm decompose` prints: at most six lines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from farm.text import format_count, format_duration


def summarise_decomposition(report: dict[str, Any], printers: int, out: Path) -> list[str]:
    """Summarise a decomposition.

    Parameters
    ----------
    report
        The report, as `--json` prints it.
    printers
        The number of printers that it was made for.
    out
        The folder with its files.

    Returns
    -------
    list of str
        At most six lines. The efficiency E in the first is the paper's: the time of the uncut model over
        printers times makespan.
    """
    parts, makespan_s = report["parts"], report["makespan_s"]
    used = report["serial_as_is_s"] / (printers * makespan_s)
    single = format_duration(report["serial_s"])
    lines = [" ".join(report["repairs"])] if report["repairs"] else []
    lines.append(
        f"{format_count(len(parts), 'part')}: {format_duration(makespan_s)} on "
        f"{format_count(printers, 'printer')}, {single} on a single large one; efficiency E {used:.2f}"
    )
    gap = f"at most {report['gap']:.0%} above the lower bound"
    askew = f", turned by {report['yaw_deg']:.0f} degrees about Z" if report["yaw_deg"] else ""
    along = " for cuts along its grid" if report["cells"] else ""
    lines.append(f"By {report['engine']}{askew}: {gap}{along}")
    glued = [joint for joint in report["joints"] if joint["glued"]]
    if glued:
        small = min(glued, key=lambda joint: float(joint["area_mm2"]))
        lines.append(
            f"{format_count(len(glued), 'joint')}; the smallest, {small['a']} to {small['b']}, has "
            f"{small['area_mm2']:.0f} mm2 of glue area and is {small['width_mm']:.1f} mm wide"
        )
    warnings = [f"{fault['part']} {fault['what']}" for fault in report["faults"]]
    warnings += [f"{part['id']} may fall over while it is printed" for part in parts if not part["stands"]]
    if warnings:
        more = f", and {len(warnings) - 3} more" if len(warnings) > 3 else ""
        lines.append(f"Check: {'; '.join(warnings[:3])}{more}")
    ends = f"{parts[0]['file']} to {parts[-1]['file']}" if len(parts) > 1 else parts[0]["file"]
    lines.append(f"In {out}: {ends}, assembly.png, assembly.glb, decomposition.json")
    return lines
