"""The time that bytes take on a serial line; asked for with ``wire=1`` in the url."""

from __future__ import annotations

import math
from collections import deque

BYTE_BITS = 10  # 8N1


class Wire:
    """One direction of the line. What is put in together comes out together, with its last byte."""

    def __init__(self, baud_rate: int) -> None:
        self._byte_s = BYTE_BITS / baud_rate
        self._under_way: deque[tuple[float, bytes]] = deque()
        self._free_s = -math.inf

    def put(self, data: bytes, now_s: float) -> None:
        """Send bytes from now on, behind those that are under way."""
        if data:
            self._free_s = max(self._free_s, now_s) + len(data) * self._byte_s
            self._under_way.append((self._free_s, data))

    def take(self, now_s: float) -> bytes:
        """All that has come through by now."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_s:
            arrived.append(self._under_way.popleft()[1])
        return b"".join(arrived)

    def due_s(self) -> float:
        """Time at which the next bytes come through; infinite where nothing is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def cut(self) -> None:
        """Lose all that is under way."""
        self._under_way.clear()
        self._free_s = -math.inf
