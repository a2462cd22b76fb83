"""Test coupon for the fit of pins in holes (`farm coupon`), written to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from decompose.connectors import make_coupon
from decompose.errors import DecomposeError
from decompose.geometry import round_triangles, write_stl
from farm.errors import ErrorCode, FarmError
from farm.planning.error_translation import translate_errors


def write_coupon(out: Path, pin_mm: float | None) -> dict[str, Any]:
    """Write the test coupon for pins of one diameter to an STL file, in its printing pose.

    Returns
    -------
    dict
        The report of `farm coupon --json`.

    Raises
    ------
    FarmError
        If `pin_mm` is None, or the file cannot be written.
    """
    if pin_mm is None:
        raise FarmError(
            "--pins none: a coupon needs pins; use --pins filament, or a diameter in mm", ErrorCode.SETTINGS
        )
    with translate_errors():
        coupon = make_coupon(pin_mm)
        corners = round_triangles(*coupon.solid.arrays())
        if corners is None:
            raise DecomposeError(
                f"the coupon for pins of {pin_mm:g} mm touches itself: choose another diameter"
            )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_stl(out, corners)
    except OSError as error:
        raise FarmError(
            f"{out}: cannot be written ({error.strerror}); name another file with --out", ErrorCode.SETTINGS
        ) from error
    return {
        "schema": 1,
        "file": str(out),
        "pin_mm": pin_mm,
        "fits_mm": list(coupon.fits_mm),
        "lengths_mm": list(coupon.lengths_mm),
    }
