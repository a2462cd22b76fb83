"""What `farm decompose` says: at most six lines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from farm.text import count, span


def decomposition_lines(report: dict[str, Any], printers: int, out: Path) -> list[str]:
    """The lines for a person, from the report as `--json` gives it.

    E is how well the printers are used: the time of the model as it stands, over printers times makespan.
    """
    parts, makespan_s = report["parts"], report["makespan_s"]
    used = report["serial_as_is_s"] / (printers * makespan_s)
    alone = span(report["serial_s"])
    lines = [" ".join(report["repairs"])] if report["repairs"] else []
    lines.append(
        f"{count(len(parts), 'part')}: {span(makespan_s)} on {count(printers, 'printer')}, "
        f"{alone} on one large one; E {used:.2f}"
    )
    least = f"at most {report['gap']:.0%} above the least that is possible"
    askew = f", turned by {report['yaw_deg']:.0f} degrees about z" if report["yaw_deg"] else ""
    along = ", by cuts along its grid" if report["cells"] else ""
    lines.append(f"By {report['engine']}{askew}: {least}{along}")
    glued = [joint for joint in report["joints"] if joint["glued"]]
    if glued:
        small = min(glued, key=lambda joint: float(joint["area_mm2"]))
        lines.append(
            f"{count(len(glued), 'joint')}; the smallest, {small['a']} to {small['b']}, has "
            f"{small['area_mm2']:.0f} mm2 of glue and is {small['width_mm']:.1f} mm wide"
        )
    warnings = [f"{fault['part']} {fault['what']}" for fault in report["faults"]]
    warnings += [f"{part['id']} may not stand while it is printed" for part in parts if not part["stands"]]
    if warnings:
        more = f", and {len(warnings) - 3} more" if len(warnings) > 3 else ""
        lines.append(f"Look at: {'; '.join(warnings[:3])}{more}")
    ends = f"{parts[0]['file']} to {parts[-1]['file']}" if len(parts) > 1 else parts[0]["file"]
    lines.append(f"In {out}: {ends}, assembly.png, assembly.glb, decomposition.json")
    return lines
