"""HTTP to the daemon's Unix socket: the standard library's, which loads at once and leaves nothing open."""

from __future__ import annotations

import socket
from http.client import HTTPConnection
from pathlib import Path

_CHUNK = 1 << 20  # bytes of an upload


class DaemonConnection(HTTPConnection):
    """For one request after another. Raises OSError or HTTPException where nobody answers, or half of it."""

    def __init__(self, path: Path, connect_s: float, answer_s: float) -> None:
        super().__init__("farm", timeout=answer_s, blocksize=_CHUNK)
        self._path, self._connect_s, self._answer_s = path, connect_s, answer_s

    def connect(self) -> None:
        way = socket.socket(socket.AF_UNIX)
        try:
            way.settimeout(self._connect_s)
            way.connect(str(self._path))
            way.settimeout(self._answer_s)
        except OSError:
            way.close()
            raise
        self.sock = way
