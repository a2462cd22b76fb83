"""Farm clock whose time a test sets."""

from drivers.clock import Clock


class ManualClock(Clock):
    """Clock that advances only when `now_s` is set."""

    def __init__(self, now_s: float = 1000.0, scale: float = 1.0) -> None:
        super().__init__(scale)
        self.now_s = now_s

    def now(self) -> float:
        return self.now_s
