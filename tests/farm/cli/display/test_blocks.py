"""Blocks of lines on a terminal of limited height."""

from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text

from farm.cli.display.blocks import Block, fit_blocks


def make_block(name, line_count, rank, min_lines=0):
    return Block([Text(f"{name} {i}") for i in range(line_count)], rank=rank, noun=name, min_lines=min_lines)


def render_blocks(blocks, height):
    return [line.plain for line in fit_blocks(blocks, height)]


def test_highest_rank_is_shortened_first_with_a_count_of_omitted_lines():
    blocks = [make_block("task", 2, 0), make_block("job", 4, 2), make_block("printer", 3, 1)]
    assert len(render_blocks(blocks, None)) == 9
    assert render_blocks(blocks, 7) == [
        *("task 0", "task 1"),
        *("job 0", "... 3 more jobs"),
        *("printer 0", "printer 1", "printer 2"),
    ]
    assert render_blocks(blocks, 5) == ["task 0", "task 1", "printer 0", "printer 1", "printer 2"]


def test_minimum_lines_of_a_block_precede_lines_of_more_important_blocks():
    blocks = [make_block("job", 4, 2, min_lines=2), make_block("printer", 50, 1, min_lines=3)]
    assert render_blocks(blocks, 5) == [
        "job 0",
        "... 3 more jobs",
        "printer 0",
        "printer 1",
        "... 48 more printers",
    ]
    assert render_blocks(blocks, 2) == ["printer 0", "... 49 more printers"]


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 3), st.integers(0, 4)), max_size=6),
    st.integers(0, 40),
)
def test_blocks_fit_the_height_and_are_complete_if_possible(sizes, height):
    blocks = [make_block("x", *size) for size in sizes]
    lines = render_blocks(blocks, height)
    assert len(lines) <= height
    if sum(size[0] for size in sizes) <= height:
        assert lines == render_blocks(blocks, None)
