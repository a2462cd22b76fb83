"""Parts as they are drawn: very detailed ones are simplified, because each step draws all parts again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.geometry import Solid
from decompose.results import Part

MAX_DRAWN_FACES = 10_000  # parts with more faces are simplified
# Tolerances, one after the other until there are few enough faces, as shares of the diagonal of the assembly:
# about a sixth and half of a pixel; curves stay smooth.
TOLERANCE_SHARES = (1e-4, 3e-4)


def simplify_parts(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Simplify the parts with very many faces, to a tolerance that a picture does not show.

    Parameters
    ----------
    parts
        Parts of one assembly; at least one. A part that cannot be simplified stays as it is.
    """
    low_mm = np.min([part.solid.bounds_mm[0] for part in parts], axis=0)
    high_mm = np.max([part.solid.bounds_mm[1] for part in parts], axis=0)
    tolerances_mm = [share * float(np.linalg.norm(high_mm - low_mm)) for share in TOLERANCE_SHARES]
    return tuple(_simplify_part(part, tolerances_mm) for part in parts)


def _simplify_part(part: Part, tolerances_mm: Sequence[float]) -> Part:
    """Simplify the solids of a part, without and with its holes and marks, if it has very many faces."""
    if part.solid.face_count <= MAX_DRAWN_FACES:
        return part
    drilled_solid = part.drilled_solid
    return replace(
        part,
        solid=_simplify_solid(part.solid, tolerances_mm),
        drilled_solid=None if drilled_solid is None else _simplify_solid(drilled_solid, tolerances_mm),
    )


def _simplify_solid(solid: Solid, tolerances_mm: Sequence[float]) -> Solid:
    """Simplify a solid until it has few enough faces to be drawn."""
    return solid.simplify_if_possible(*tolerances_mm, max_faces=MAX_DRAWN_FACES)
