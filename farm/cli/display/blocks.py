"""Blocks of lines that fit into the height of a terminal; less important blocks are shortened first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.text import Text

from farm.cli.display.console import NOTE_STYLE
from farm.text import format_count


@dataclass(frozen=True, slots=True)
class Block:
    """Lines that belong together.

    Attributes
    ----------
    lines
        The lines, the most important first.
    rank
        Order in which blocks are shortened: the highest rank first, 0 last.
    noun
        Word for one line of the block, in the count of omitted lines.
    min_lines
        Number of lines of this block that are kept as long as any other block is longer than its own minimum.
    """

    lines: Sequence[Text]
    rank: int = 0
    noun: str = "line"
    min_lines: int = 0


def fit_blocks(blocks: Sequence[Block], height: int | None) -> list[Text]:
    """Return at most `height` lines of the blocks, in order; return all lines if `height` is None.

    The last line of a shortened block states the number of omitted lines.
    """
    line_counts = [len(block.lines) for block in blocks]
    shortening_order = sorted(range(len(blocks)), key=lambda i: blocks[i].rank, reverse=True)
    if height is not None:
        for min_counts in ([block.min_lines for block in blocks], [0] * len(blocks)):
            for i in shortening_order:
                excess = max(0, sum(line_counts) - height)
                line_counts[i] = max(min(line_counts[i], min_counts[i]), line_counts[i] - excess)
    lines = []
    for block, line_count in zip(blocks, line_counts, strict=True):
        lines += list(block.lines) if line_count == len(block.lines) else _shorten_block(block, line_count)
    return lines


def _shorten_block(block: Block, line_count: int) -> list[Text]:
    if line_count == 0:
        return []
    rest = format_count(len(block.lines) - line_count + 1, f"more {block.noun}")
    return [*block.lines[: line_count - 1], Text(f"... {rest}", style=NOTE_STYLE)]
