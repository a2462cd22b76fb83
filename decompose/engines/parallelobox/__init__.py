"""The engine `parallelobox`: blocks grown from seeds, as in the paper of that name."""

from __future__ import annotations

from decompose.engines.parallelobox.search import cut_by_parallelobox, paper_settings

__all__ = [
    "cut_by_parallelobox",
    "paper_settings",
]
