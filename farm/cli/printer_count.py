"""A number of printers as a person gives it."""

from __future__ import annotations

import typer


def count_or_auto(printers: str) -> int | None:
    """`--printers`: a number from 1; None for ``auto``."""
    if printers == "auto":
        return None
    if not printers.isdigit() or int(printers) < 1:
        raise typer.BadParameter("a number from 1, or auto", param_hint="--printers")
    return int(printers)
