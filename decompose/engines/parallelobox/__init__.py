"""The engine `parallelobox`: blocks that grow from seeds, as in the paper of that name."""

from __future__ import annotations

from decompose.engines.parallelobox.search import apply_paper_settings, cut_by_parallelobox

__all__ = [
    "apply_paper_settings",
    "cut_by_parallelobox",
]
