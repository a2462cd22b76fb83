"""Serial line that delays bytes by their transmission time; enabled by ``wire=1`` in the url."""

from __future__ import annotations

import math
from collections import deque

BYTE_BITS = 10  # 8N1


class Wire:
    """One direction of the line. The bytes of one call of `put` arrive together, when the last one does."""

    def __init__(self, baud_rate: int) -> None:
        self._byte_duration_s = BYTE_BITS / baud_rate
        self._in_transit: deque[tuple[float, bytes]] = deque()
        self._free_s = -math.inf

    def put(self, data: bytes, now_s: float) -> None:
        """Send bytes after those in transit."""
        if data:
            self._free_s = max(self._free_s, now_s) + len(data) * self._byte_duration_s
            self._in_transit.append((self._free_s, data))

    def take(self, now_s: float) -> bytes:
        """Return the bytes that have arrived by now."""
        arrived_bytes = []
        while self._in_transit and self._in_transit[0][0] <= now_s:
            arrived_bytes.append(self._in_transit.popleft()[1])
        return b"".join(arrived_bytes)

    def compute_due_s(self) -> float:
        """Return the arrival time of the next bytes; infinite if none are in transit."""
        return self._in_transit[0][0] if self._in_transit else math.inf

    def clear(self) -> None:
        """Drop all bytes in transit."""
        self._in_transit.clear()
        self._free_s = -math.inf
