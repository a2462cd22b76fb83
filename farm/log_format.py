"""Format of the daemon's log: lines of text, or one line of JSON for each record."""

from __future__ import annotations

import json
import logging
from collections.abc import MutableMapping
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

SUBJECTS = ("job", "plate", "printer", "who")
"""Attributes of a record, set through `extra`, that a JSON line contains in addition to the message."""


class LogFormat(StrEnum):
    """Format of the daemon's log."""

    TEXT = "text"
    JSON = "json"


class JsonFormatter(logging.Formatter):
    """Formatter that writes a record as one line of JSON: at, level, logger, message, SUBJECTS, exception."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as one line, without a line break."""
        time = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        fields = {
            "at": time,
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        fields |= {name: value for name in SUBJECTS if (value := getattr(record, name, None)) is not None}
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        return json.dumps(fields, default=str)


class PrinterLog(logging.LoggerAdapter[logging.Logger]):
    """Logger for one printer: it adds the printer's name to each message and to each line of JSON."""

    def __init__(self, logger: logging.Logger, printer: str) -> None:
        super().__init__(logger, {"printer": printer})
        self._printer = printer  # contains no `%`: see `config.Name`

    def process(self, msg: str, kwargs: MutableMapping[str, Any]) -> tuple[str, MutableMapping[str, Any]]:
        """Return the message with the name before it, and the arguments with the record's attributes."""
        return f"{self._printer}: {msg}", {**kwargs, "extra": self.extra}


def start_log(log_format: LogFormat) -> None:
    """Send log records of this process, from the level INFO upwards, to its standard error stream."""
    handler = logging.StreamHandler()
    text = logging.Formatter("%(asctime)s %(name)s %(message)s")
    handler.setFormatter(JsonFormatter() if log_format is LogFormat.JSON else text)
    logging.basicConfig(level=logging.INFO, force=True, handlers=[handler])
