"""Moves of a G-code file as columns of numbers."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slicing.checks.toolpath import NO_LAYER, read_toolpath
from slicing.errors import Rule, SliceRejected

GCODE = b""";FLAVOR:Marlin
G28
G1 F1200 X5 Y10
M109 S210 ; wait
;LAYER:0
;TYPE:SKIRT
G1 F600 X6 E1.5
G1 Y-11.25
G92 E0
;TYPE:WALL-OUTER
G1X7Y8 E2 ; written in another way
G91
G1 Z2 E-1
G90
;LAYER:1
M83
G1 X0 E.5
G1 X1 E.5
"""


def test_modes_resets_and_notations_are_read():
    toolpath = read_toolpath(GCODE)
    assert toolpath.end.tolist() == [
        [5, 10, 0, 0],
        [6, 10, 0, 1.5],
        [6, -11.25, 0, 1.5],
        [7, 8, 0, 2],
        [7, 8, 2, 1],
        [0, 8, 2, 1.5],
        [1, 8, 2, 2],
    ]
    assert toolpath.extruded_mm.tolist() == [0, 1.5, 0, 2, -1, 0.5, 0.5]
    assert toolpath.feed_mm_min.tolist() == [1200] + 6 * [600]
    assert toolpath.layer.tolist() == [NO_LAYER, 0, 0, 0, 0, 1, 1]
    assert np.flatnonzero(toolpath.is_feature("WALL-OUTER")).tolist() == [3, 4, 5, 6]
    assert not toolpath.is_feature("SKIN").any()
    assert toolpath.is_head_move.tolist() == [True] * 7
    wait_command = next(command for command in toolpath.commands if command.code == "M109")
    assert (wait_command.next_move, wait_command.words) == (1, {"S": 210.0})
    comment = toolpath.comments[1]
    assert (comment.next_move, comment.text) == (1, "LAYER:0")
    assert GCODE[comment.offset :].startswith(b";LAYER:0\n")


@pytest.mark.parametrize("text", [b"", b"\n\n", b";only a comment", b"G28", b"G1 X1"])
def test_empty_and_tiny_files_are_read(text):
    toolpath = read_toolpath(text)
    assert len(toolpath.end) == len(toolpath.layer) == len(toolpath.feed_mm_min) == text.count(b"G1")


@pytest.mark.parametrize("line", [b"g1 is no command here", b"G1X7Y8E2", b"G1 X", b"\xff", b"M104 S2e5 x"])
def test_line_that_the_firmware_misreads_is_refused_with_its_number(line):
    with pytest.raises(SliceRejected, match="line 3: ") as error:
        read_toolpath(b"G28\nG1 X1\n" + line + b"\nG1 X2\n")
    assert error.value.rule is Rule.FLAVOUR


NUMBERS = st.integers(-99_999, 99_999).map(lambda n: n / 1000)
MOVES = st.dictionaries(st.sampled_from("XYZEF"), NUMBERS, min_size=1)
OTHER_LINES = st.sampled_from([";TYPE:SKIN", ";LAYER:3", "M107", "", "G92 X1 E0", "M105 ; G1 X1"])


@given(st.lists(st.one_of(MOVES, OTHER_LINES), max_size=40), st.booleans())
def test_columns_equal_those_of_a_line_reader(lines, has_spaces):
    text, expected_rows = [], []
    position = dict.fromkeys("XYZE", 0.0)
    for line in lines:
        if isinstance(line, str):
            text.append(line)
            if line.startswith("G92"):
                position |= {"X": 1.0, "E": 0.0}
            continue
        line_words = [f"{letter}{number:.3f}" for letter, number in line.items()]
        text.append(
            " ".join(["G1", *line_words]) if has_spaces else "G1" + "".join(line_words).replace("E", " E")
        )
        position |= {letter: number for letter, number in line.items() if letter != "F"}
        expected_rows.append(list(position.values()))
    ends = read_toolpath("\n".join(text).encode()).end
    assert ends == pytest.approx(np.array(expected_rows).reshape(-1, 4))


def test_block_of_moves_without_an_end_takes_little_memory():
    """Limit the memory, because `re` keeps 50 bytes of backtracking state for each byte of a block."""
    text = b"G1 X10.125 Y10.125 E10.125\n" * 40_000
    tracemalloc.start()
    try:
        toolpath = read_toolpath(text)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(toolpath.end) == 40_000
    assert peak_bytes < 20 * len(text)
