"""Peak memory of this process alone."""

from __future__ import annotations

from pathlib import Path


def read_peak_mb() -> float:
    """Read the peak of the resident memory since the program was started, in MB.

    `ru_maxrss` of `getrusage` is not used: it begins with the memory of the process that started this one.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM:"))
