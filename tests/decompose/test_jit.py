"""Machine code is kept for as long as nothing of what is compiled changes."""

from __future__ import annotations

from pathlib import Path

from decompose.jit import hash_sources


def test_a_change_in_any_compiled_file_is_seen(tmp_path: Path) -> None:
    cost, boxes, words = (tmp_path / name for name in ("cost.py", "boxes.py", "words.py"))
    cost.write_text("from decompose.jit import jit\nPRICE = 1.0\n")
    boxes.write_text("from decompose.jit import jit\nfrom decompose.cost import PRICE\n")
    words.write_text("SAID = 'nothing that is compiled'\n")
    before = hash_sources(tmp_path)
    words.write_text("SAID = 'something else'\n")
    assert hash_sources(tmp_path) == before
    cost.write_text("from decompose.jit import jit\nPRICE = 2.0\n")
    assert hash_sources(tmp_path) != before
