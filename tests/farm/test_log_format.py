"""Log of the daemon: a line of JSON for each record, with its subjects."""

from __future__ import annotations

import json
import logging
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.log_format import JsonFormatter, LogFormat, PrinterLog, start_log

TEXTS = st.text()


def make_record(text: str, **extra: object) -> logging.LogRecord:
    return logging.getLogger("farm.test").makeRecord(
        "farm.test", logging.WARNING, "", 0, text, (), None, extra=extra
    )


@given(TEXTS, TEXTS)
def test_any_text_is_one_line_of_json(text: str, user: str):
    line = JsonFormatter().format(make_record(text.replace("%", "%%"), job=3, who=user))
    assert len(line.splitlines()) == 1 and line.isascii()
    fields = json.loads(line)
    assert fields["message"] == text.replace("%", "%%") and fields["job"] == 3 and fields["who"] == user
    assert (fields["level"], fields["logger"]) == ("warning", "farm.test")
    assert "plate" not in fields


def test_exception_is_a_field_of_its_line():
    try:
        raise ValueError("broken\nin two lines")
    except ValueError:
        broken_record = make_record("job 3")
        broken_record.exc_info = sys.exc_info()
    [line] = JsonFormatter().format(broken_record).splitlines()
    assert "ValueError: broken\nin two lines" in json.loads(line)["exception"]


def test_log_of_a_printer_begins_with_its_name(caplog: pytest.LogCaptureFixture):
    PrinterLog(logging.getLogger("farm.test"), "um2-01").warning("its agent ended with %s", 3)
    [log_record] = caplog.records
    assert log_record.getMessage() == "um2-01: its agent ended with 3"
    assert log_record.__dict__["printer"] == "um2-01"


@pytest.mark.parametrize("log_format", LogFormat)
def test_log_is_written_to_the_standard_error_stream(log_format, capsys, monkeypatch):
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    start_log(log_format)
    logging.getLogger("farm.test").info("hello", extra={"plate": "3/07"})
    line = capsys.readouterr().err.strip()
    if log_format is LogFormat.JSON:
        assert json.loads(line)["plate"] == "3/07"
    else:
        assert line.endswith("farm.test hello")
