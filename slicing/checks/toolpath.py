"""G-code file as columns of numbers: one row for each move, and the lines between the moves.

CuraEngine writes tens of thousands of moves in a second, so they are read by columns: a regular expression
matches whole blocks of plain moves, and only the few other lines are read one by one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slicing.errors import GcodeRefused, Rule, SliceRejected
from slicing.gcode_lines import PLAIN_MOVE, Words, parse_words, split_line

Floats = npt.NDArray[np.float64]

# The second group matches any text, so `re` never backtracks over a block and the time stays linear. A block
# is bounded because `re` needs 50 bytes of memory for each byte of a block.
_BLOCK = re.compile(rb"((?:%b\n){0,1000})([^\n]*\n?)" % PLAIN_MOVE)
_LETTERS = b"GFXYZE\r\n"
_LETTERS_TO_SPACES = bytes.maketrans(_LETTERS, b" " * len(_LETTERS))
_AXES = b"XYZE"
TIME_PREFIX = "TIME_ELAPSED:"


@dataclass(frozen=True, slots=True)
class Comment:
    """Comment: the index of the next move, its offset in the file, and its text without ``;``."""

    next_move: int
    offset: int
    text: str


@dataclass(frozen=True, slots=True)
class Command:
    """Line other than a move: the index of the next move, its code (``G28``), and its words."""

    next_move: int
    code: str
    words: Words


@dataclass(frozen=True, slots=True)
class Toolpath:
    """Moves (G0, G1) of a file and the lines between them, as the firmware reads them.

    Attributes
    ----------
    start, end
        (n, 4) X, Y, Z and E in mm, in the printer's coordinates.
    feed_mm_min
        (n,) The feedrate of each move; 0 before the first F.
    layer
        (n,) The number of the ``;LAYER:`` above a move; `NO_LAYER` before the first.
    feature
        (n,) Index in `features` of the ``;TYPE:`` above a move.
    features
        Cura's names of the features; the first one is empty, for moves before the first ``;TYPE:``.
    comments, commands
        The lines between the moves.
    """

    start: Floats
    end: Floats
    feed_mm_min: Floats
    layer: npt.NDArray[np.int32]
    feature: npt.NDArray[np.uint8]
    features: tuple[str, ...]
    comments: tuple[Comment, ...]
    commands: tuple[Command, ...]

    @property
    def extruded_mm(self) -> Floats:
        """Filament (n,) in mm that each move extrudes; negative if it retracts."""
        return self.end[:, 3] - self.start[:, 3]

    @property
    def is_head_move(self) -> npt.NDArray[np.bool_]:
        """Mask (n,) of the moves in which the head moves, rather than only the filament."""
        return np.asarray((self.end[:, :3] != self.start[:, :3]).any(axis=1))

    @property
    def first_layer_move(self) -> int | None:
        """Number of moves before the first layer; None without layers."""
        return next(
            (comment.next_move for comment in self.comments if comment.text.startswith("LAYER:")), None
        )

    def list_layer_ends(self) -> list[tuple[int, float]]:
        """List, for each layer, the number of moves before its end and Cura's estimate of the time there."""
        return [
            (comment.next_move, float(comment.text[len(TIME_PREFIX) :]))
            for comment in self.comments
            if comment.text.startswith(TIME_PREFIX)
        ]

    def is_feature(self, name: str) -> npt.NDArray[np.bool_]:
        """Mark the moves (n,) of a feature, by Cura's name for it."""
        code = self.features.index(name) if name in self.features else len(self.features)
        return np.asarray(self.feature == code)


NO_LAYER = -(2**31)


def read_toolpath(gcode: bytes) -> Toolpath:
    """Read a G-code file.

    ``G90 G91 M82 M83 G92`` are interpreted; homing does not change the coordinates.

    Parameters
    ----------
    gcode
        The whole file.

    Raises
    ------
    SliceRejected
        `FLAVOUR` if the firmware would read a line differently, or not at all.
    """
    text, move_count, comments, commands = _split_file(gcode)
    columns = _read_columns(text, move_count)
    start, end = _find_positions(columns, commands)
    features = (
        "",
        *dict.fromkeys(comment.text[5:] for comment in comments if comment.text.startswith("TYPE:")),
    )
    return Toolpath(
        start=start,
        end=end,
        feed_mm_min=_fill_gaps(columns[ord("F")], 0.0),
        layer=_expand_steps(_find_layers(comments), NO_LAYER, move_count).astype(np.int32),
        feature=_expand_steps(_find_features(comments, features), 0, move_count).astype(np.uint8),
        features=features,
        comments=tuple(comments),
        commands=tuple(commands),
    )


def _split_file(gcode: bytes) -> tuple[bytes, int, list[Comment], list[Command]]:
    """Split a file into moves in the form of `PLAIN_MOVE`, their number, the comments and the commands."""
    blocks: list[bytes] = []
    comments: list[Comment] = []
    commands: list[Command] = []
    move_count = number = 0
    for match in _BLOCK.finditer(gcode):
        block, line = match.groups()
        blocks.append(block)
        move_count += block.count(b"\n")
        number += block.count(b"\n") + 1
        if line.startswith(b";"):
            comments.append(Comment(move_count, match.start(2), line[1:].decode("utf-8", "replace").strip()))
            continue
        try:
            code, rest, _ = split_line(line, number)
            words = parse_words(rest, number)
        except GcodeRefused as error:
            raise SliceRejected(Rule.FLAVOUR, str(error)) from error
        if code in ("G0", "G1"):
            words_text = "".join(
                f" {letter}{value:.9f}" for letter, value in words.items() if letter in "XYZEF"
            )
            blocks.append(b"G%b\n" % words_text.encode())
            move_count += 1
        elif code:
            commands.append(Command(move_count, code, words))
    return b"".join(blocks), move_count, comments, commands


def _read_columns(text: bytes, move_count: int) -> dict[int, Floats]:
    """Read the value (n,) of each letter in each move; NaN if the move lacks the letter."""
    raw = np.frombuffer(text, np.uint8)
    letters = raw[raw >= ord("E")]  # E to Z: the letters, and nothing else in a plain move
    numbers = _parse_numbers(text)
    row = np.cumsum(letters == ord("G")) - 1
    is_word = letters != ord("G")
    letters, row = letters[is_word], row[is_word]
    columns: dict[int, Floats] = {}
    for letter in b"XYZEF":
        column = np.full(move_count, np.nan)
        is_letter = letters == letter
        column[row[is_letter]] = numbers[is_letter]
        columns[letter] = column
    return columns


def _parse_numbers(text: bytes) -> Floats:
    """Parse all numbers of plain moves in their order, without the code after each G."""
    number_text = text.replace(b"G0", b"").replace(b"G1", b"").translate(_LETTERS_TO_SPACES)
    if not number_text.strip():
        return np.empty(0)
    return np.fromstring(number_text, sep=" ")


def _find_positions(columns: dict[int, Floats], commands: Iterable[Command]) -> tuple[Floats, Floats]:
    """Compute the points (n, 4) where each move starts and ends, in the modes that the commands set."""
    move_count = len(columns[ord("X")])
    start, end = np.empty((move_count, 4)), np.empty((move_count, 4))
    position = [0.0] * 4
    is_relative = is_relative_e = False
    row = 0

    def fill_rows(stop: int) -> None:
        nonlocal row
        if stop == row:
            return
        for axis, letter in enumerate(_AXES):
            values = columns[letter][row:stop]
            if is_relative or (is_relative_e and axis == 3):
                end[row:stop, axis] = position[axis] + np.cumsum(np.nan_to_num(values))
            else:
                end[row:stop, axis] = _fill_gaps(values, position[axis])
            start[row, axis] = position[axis]
            start[row + 1 : stop, axis] = end[row : stop - 1, axis]
            position[axis] = float(end[stop - 1, axis])
        row = stop

    for command in commands:
        if command.code not in ("G90", "G91", "G92", "M82", "M83"):
            continue
        fill_rows(command.next_move)
        match command.code:
            case "G90" | "G91":
                is_relative = command.code == "G91"
            case "M82" | "M83":
                is_relative_e = command.code == "M83"
            case "G92":
                for axis, letter in enumerate("XYZE"):
                    number = command.words.get(letter)
                    position[axis] = position[axis] if number is None else number
    fill_rows(move_count)
    return start, end


def _fill_gaps(column: Floats, first: float) -> Floats:
    """Replace each NaN with the number before it, or with `first` if there is none."""
    is_known = ~np.isnan(column)
    last = np.maximum.accumulate(np.where(is_known, np.arange(len(column)), -1)) if len(column) else is_known
    return np.where(last < 0, first, column[last])


def _expand_steps(steps: list[tuple[int, int]], first: int, move_count: int) -> npt.NDArray[np.int64]:
    """Expand steps (move, value) to the value (n,) at each move; a value holds until the next step."""
    starts = [0, *(move for move, _ in steps), move_count]
    return np.repeat(np.array([first, *(value for _, value in steps)], np.int64), np.diff(starts))


def _find_layers(comments: Iterable[Comment]) -> list[tuple[int, int]]:
    """Find the moves at which layers begin, with the numbers of the layers."""
    layers = [
        (comment.next_move, comment.text[6:]) for comment in comments if comment.text.startswith("LAYER:")
    ]
    return [(move, int(number)) for move, number in layers if number.lstrip("-").isdecimal()]


def _find_features(comments: Iterable[Comment], features: tuple[str, ...]) -> list[tuple[int, int]]:
    """Find the moves at which features begin, with the indices of the features."""
    code = {name: number for number, name in enumerate(features)}
    return [
        (comment.next_move, code[comment.text[5:]])
        for comment in comments
        if comment.text.startswith("TYPE:")
    ]
