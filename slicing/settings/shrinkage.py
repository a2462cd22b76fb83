"""Shrinkage of materials: factors by which parts are printed larger.

Material files of Cura 4.13 and 5.0 say 100 % or nothing. PLA, Tough PLA and PETG are Cura 5.0's own figures,
from its profiles for the Ultimaker S3 and S5. The others are [assumed]: typical shrinkage of printed parts,
below what data sheets give for moulded ones; across layers half of that along them, as Cura has it for PLA.
"""

from __future__ import annotations

from collections.abc import Mapping

NONE = (1.0, 1.0)
_BY_KIND: Mapping[str, tuple[float, float]] = {
    kind: (1 + xy_percent / 100, 1 + z_percent / 100)
    for kind, xy_percent, z_percent in (
        ("PLA", 0.2, 0.1),
        ("Tough PLA", 0.3, 0.1),
        ("PETG", 0.5, 0.1),
        ("ABS", 0.7, 0.35),
        ("ASA", 0.6, 0.3),
        ("HIPS", 0.6, 0.3),
        ("CPE", 0.4, 0.2),
        ("CPE+", 0.5, 0.25),
        ("PC", 0.6, 0.3),
        ("Nylon", 1.0, 0.5),
        ("PP", 1.8, 0.9),
        ("TPU", 0.6, 0.3),
        ("TPU 95A", 0.6, 0.3),
    )
}


def shrinkage_factors(kind: str) -> tuple[float, float]:
    """Find the factors (XY, Z) by which parts of a kind of material are printed larger; 1 where unknown."""
    return _BY_KIND.get(kind, NONE)
