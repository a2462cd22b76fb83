"""Conversion of times, and of sentences with times and commands, to HTML. Pure.

Times are in the farm's time zone; the script `page.js` converts them to the user's.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from markupsafe import Markup, escape

from farm.model import TextTime
from farm.text import format_moment

_LAST_COMMAND_PATTERN = re.compile(r"(?:, then|; then|:) `farm [^`]*`$")


class TimedText(Protocol):
    """Object with a sentence and the times in it, such as a hold or a task."""

    @property
    def text(self) -> str: ...

    @property
    def times(self) -> Sequence[TextTime]: ...


@dataclass(frozen=True, slots=True)
class Sentence:
    """Sentence, with the times that it contains."""

    text: str
    times: Sequence[TextTime] = ()


def format_sentence(sentence: TimedText) -> Markup:
    """Format a sentence as HTML, with commands in backticks as `<code>`, and times as `<time>`.

    A command at the end is left out, because the pages have a button for it.
    """
    text = _LAST_COMMAND_PATTERN.sub("", sentence.text)
    pieces = text.split("`")
    if len(pieces) % 2 == 0:  # an unpaired backtick, such as in the name of a model
        return _format_times(text, sentence.times)
    code = Markup("<code>{}</code>")
    return Markup("").join(
        code.format(piece) if index % 2 else _format_times(piece, sentence.times)
        for index, piece in enumerate(pieces)
    )


def format_commands(text: str) -> Markup:
    """Format a sentence without times, as `format_sentence` does."""
    return format_sentence(Sentence(text))


def _format_times(text: str, times: Sequence[TextTime]) -> Markup:
    """Format a text as HTML, with the given times in it as `<time>`."""
    moments = {time.text: time.at for time in times}
    if not moments:
        return escape(text)
    pattern = "|".join(map(re.escape, sorted(moments, key=len, reverse=True)))
    pieces = re.split(f"({pattern})", text)
    return Markup("").join(
        _make_time_element(moments[piece], piece) if piece in moments else escape(piece) for piece in pieces
    )


def format_time_element(time: str | None, now: str) -> Markup:
    """Format a time as `<time>`; return an empty text for None.

    Parameters
    ----------
    time, now
        The time, and the current time on the farm's clock, as ISO 8601.
    """
    if time is None:
        return Markup("")
    return _make_time_element(time, format_moment(datetime.fromisoformat(time), datetime.fromisoformat(now)))


def _make_time_element(time: str, text: str) -> Markup:
    return Markup('<time datetime="{}">{}</time>').format(time, text)


class NamedTime(Protocol):
    """Time as ISO 8601 and as text, such as a `TextTime`, or a `TimeMark` of a chart."""

    @property
    def at(self) -> str: ...

    @property
    def text(self) -> str: ...


def format_time_attributes(time: NamedTime) -> Markup:
    """Return the attributes that mark a time in an element that cannot contain `<time>`, such as in SVG."""
    return Markup('data-time="{}" data-text="{}"').format(time.at, time.text)
