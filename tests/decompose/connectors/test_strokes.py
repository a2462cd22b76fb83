"""Texts of strokes, whose letters have their own widths."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.connectors.strokes import (
    GAP,
    GRID_HEIGHT,
    LETTERS,
    draw_strokes,
    list_letter_middles,
    measure_text_width,
)


def test_text_is_centred_and_its_letters_keep_their_distance():
    strokes = draw_strokes("10-^")
    assert [strokes[..., axis].min() + strokes[..., axis].max() for axis in (0, 1)] == pytest.approx(
        [0.0, 0.0]
    )
    assert np.ptp(strokes[..., 0]) == pytest.approx(measure_text_width("10-^")) == 1 + 3 + 2 + 4 + 3 * GAP
    assert np.ptp(strokes[..., 1]) == GRID_HEIGHT
    assert np.diff(list_letter_middles("00")) == pytest.approx([3 + GAP])


def test_digits_differ_by_at_least_one_stroke():
    drawn = {
        digit: {frozenset(map(tuple, stroke.round(6).tolist())) for stroke in draw_strokes(digit)}
        for digit in "0123456789"
    }
    assert all(len(drawn[a] ^ drawn[b]) >= 1 for a in drawn for b in drawn if a != b)
    assert max(len(strokes) for strokes in drawn.values()) == 5


def test_unknown_letter_is_a_gap():
    assert measure_text_width("1_1") == 1 + 4 + 1 + 2 * GAP
    assert len(draw_strokes("1_1")) == 2 * len(draw_strokes("1"))
    assert all(set(line) <= set("0123456| ") for line in LETTERS.values())
