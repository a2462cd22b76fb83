"""Letters that consist of straight strokes, on a grid 6 units high.

Each stroke becomes a groove, which takes time to print and to check. So digits have few strokes, and no
rounded corners.
"""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats

GRID_HEIGHT = 6.0
GAP = 1.6  # distance between two letters

# Each letter consists of polylines, whose points x, y are pairs of digits.
LETTERS = {
    "0": "00 06 36 30 00",
    "1": "05 16 10",
    "2": "06 36 33 03 00 30",
    "3": "06 36 30 00|03 33",
    "4": "20 26 02 32",
    "5": "36 06 03 33 30 00",
    "6": "36 06 00 30 33 03",
    "7": "06 36 10",
    "8": "00 06 36 30 00|03 33",
    "9": "33 03 06 36 30 00",
    "-": "03 23",
    "^": "02 24 42",
    ".": "00",
    "A": "00 26 40|12 32",
    "B": "03 33 44 45 36 06 00 30 41 42 33",
    "C": "45 36 16 05 01 10 30 41",
    "D": "00 06 26 44 42 20 00",
    "E": "46 06 00 40|03 33",
    "F": "46 06 00|03 33",
    "G": "45 36 16 05 01 10 30 41 43 23",
    "H": "00 06|40 46|03 43",
    "I": "20 26",
    "J": "46 41 30 10 01",
    "K": "00 06|46 03 40",
    "L": "06 00 40",
    "M": "00 06 23 46 40",
    "N": "00 06 40 46",
    "O": "00 06 46 40 00",
    "P": "00 06 36 45 44 33 03",
    "Q": "10 30 41 45 36 16 05 01 10|22 40",
    "R": "00 06 36 45 44 33 03|23 40",
    "S": "45 36 16 05 04 13 33 42 41 30 10 01",
    "T": "06 46|26 20",
    "U": "06 01 10 30 41 46",
    "V": "06 20 46",
    "W": "06 10 23 30 46",
    "X": "00 46|06 40",
    "Y": "06 23 46|23 20",
    "Z": "06 46 00 40",
}


def measure_text_width(text: str) -> float:
    """Measure the width of a text in units of the grid."""
    return float(sum(map(_measure_letter_width, text.upper())) + GAP * (len(text) - 1))


def list_letter_middles(text: str) -> list[float]:
    """List the horizontal positions of the middles of the letters, from the middle of the text."""
    middles, left = [], -measure_text_width(text) / 2.0
    for letter in text.upper():
        middles.append(left + _measure_letter_width(letter) / 2.0)
        left += _measure_letter_width(letter) + GAP
    return middles


def draw_strokes(text: str) -> Floats:
    """Draw a text with its middle at the origin.

    Parameters
    ----------
    text
        Digits, letters, `-`, `.` and `^`; letters are drawn as capitals, and other characters as spaces.

    Returns
    -------
    Floats
        (k, 2, 2) ends of the strokes in units of the grid, x to the right and y up. A dot is a stroke without
        length.
    """
    strokes: list[list[list[float]]] = []
    for middle, letter in zip(list_letter_middles(text), text.upper(), strict=True):
        left, bottom = middle - _measure_letter_width(letter) / 2.0, -GRID_HEIGHT / 2.0
        for line in filter(None, LETTERS.get(letter, "").split("|")):
            points = [[left + float(point[0]), bottom + float(point[1])] for point in line.split()]
            strokes += [list(pair) for pair in zip(points, points[1:] or points, strict=False)]
    return np.array(strokes).reshape(-1, 2, 2)


def _measure_letter_width(letter: str) -> int:
    """Measure the width of a letter in units of the grid; any unknown character is 4 units wide."""
    return max((int(point[0]) for point in LETTERS.get(letter, "40").replace("|", " ").split()), default=0)
