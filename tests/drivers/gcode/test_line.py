"""Fast matching of plain moves, compared with the full reader of lines."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.firmware import ULTIMAKER2
from drivers.gcode.line import match_plain_move, read_command

NUMBERS = st.sampled_from(["", "-", ".", "1", "-2.", "0.5", ".5", "123456", "1234567", "1.2.3", "1e3"])
WORDS = st.tuples(st.sampled_from(["", " ", "  "]), st.sampled_from("FXYZEGMN"), NUMBERS).map("".join)
LINES = st.tuples(st.sampled_from(["G0", "G1", "G01", "G92"]), st.lists(WORDS, max_size=5).map("".join))


@pytest.mark.parametrize("line", [b"G1 X", b"G1 X1 Y", b"G1 F1500 X1 E", b"G1 X1 Y2 E-", b"G1 X1234567"])
def test_move_with_a_letter_without_a_number_is_not_plain(line: bytes) -> None:
    """Use letters without a number, which the firmware reads as 0."""
    assert not match_plain_move(line)


@given(LINES.map("".join).map(str.encode))
def test_plain_moves_are_sent_unchanged(line: bytes) -> None:
    """Check that the slower reader of all lines does not change a plain move."""
    if match_plain_move(line):
        command = read_command(line, 1, ULTIMAKER2)
        assert command is not None
        assert command.text == line
        assert None not in command.words.values()


@given(st.lists(st.integers(-9999, 9999).map(lambda n: n / 100), min_size=4, max_size=4), st.integers(0, 15))
def test_moves_of_slicers_are_plain(numbers: list[float], letter_mask: int) -> None:
    letters_and_numbers = [f" {letter}{number:g}" for letter, number in zip("FXYE", numbers, strict=True)]
    assert match_plain_move(
        ("G1" + "".join(w for n, w in enumerate(letters_and_numbers) if letter_mask >> n & 1)).encode()
    )
