"""Tables as wide as the terminal."""

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.text import Text

from farm.cli.display.table import Column, lay_out_table, wrap_text

COLUMNS = (Column("NAME"), Column("LESS", rank=2), Column("NOTE", rank=1, min_width=6), Column("END"))
ROWS = [("um2-01", "1.00", "a long sentence", "in 5h00"), ("um2-02", "", "", "")]
CELLS = st.text(st.characters(categories=("L", "N", "P", "S")), max_size=20)


def render_plain(lines):
    return [line.plain for line in lines]


def test_wide_table_has_every_column():
    rows = [
        "NAME    LESS  NOTE             END",
        "um2-01  1.00  a long sentence  in 5h00",
        "um2-02",
    ]
    assert render_plain(lay_out_table(COLUMNS, ROWS, 38)) == rows
    assert render_plain(lay_out_table(COLUMNS, ROWS, None)) == rows


def test_highest_rank_is_omitted_first_and_its_width_is_reused():
    assert render_plain(lay_out_table(COLUMNS, ROWS, 37))[1] == ("um2-01  1.00  a long senten…  in 5h00")
    assert render_plain(lay_out_table(COLUMNS, ROWS, 28))[1] == "um2-01  a long sen…  in 5h00"
    assert render_plain(lay_out_table(COLUMNS, ROWS, 20))[1] == "um2-01  in 5h00"


def test_empty_column_is_omitted_before_any_text_is_shortened():
    rows = [("um2-01", "", "a long sentence", "in 5h00")]
    assert render_plain(lay_out_table(COLUMNS, rows, 36))[1] == "um2-01  a long sentence  in 5h00"


def test_row_takes_several_lines_in_a_narrow_terminal():
    assert render_plain(lay_out_table(COLUMNS, ROWS, 12)) == ["NAME  END", "um2-01  in", "  5h00", "um2-02"]


@given(
    st.lists(st.tuples(st.text("ab-1", min_size=1, max_size=20), CELLS, CELLS, CELLS), max_size=5),
    st.integers(1, 120),
)
def test_lines_fit_the_terminal_and_keep_every_name(rows, width):
    lines = render_plain(lay_out_table(COLUMNS, rows, max(width, 22)))
    assert all(cell_len(line) <= max(width, 22) for line in lines)
    names = iter(lines[1:])
    assert all(any(line.startswith(row[0]) for line in names) for row in rows)


@given(st.text("ab ", max_size=60), st.integers(3, 30), st.integers(0, 5))
def test_wrapped_text_is_complete(text, width, indent):
    lines = render_plain(wrap_text(Text(text), width, indent))
    assert all(len(line) <= width for line in lines) or text.isspace()
    assert "".join("".join(lines).split()) == "".join(text.split())


def test_command_that_fits_a_line_is_not_broken():
    text = Text("resume um2-02 by Mon 04:19, or it ends: `farm resume um2-02`")
    assert render_plain(wrap_text(text, 50, 2)) == [
        "resume um2-02 by Mon 04:19, or it ends:",
        "  `farm resume um2-02`",
    ]
