"""Spans and moments for people."""

import pytest

from farm.cli.words import moment, span


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (None, "-"),
        (0.4, "0 s"),
        (119.4, "119 s"),
        (120, "2 min"),
        (3599, "1h00"),
        (27420, "7h37"),
        (360000, "100h00"),
    ],
)
def test_spans(seconds, words):
    assert span(seconds) == words


def test_moments():
    assert moment(None) == "-"
    assert moment("2026-11-21T07:05:09+00:00") == "Sat 07:05"
