"""Planning on a machine without semaphores."""

import subprocess
import sys

import pytest

NO_SEMAPHORES = """
import _multiprocessing

def refuse(*_, **__):
    raise FileNotFoundError(2, "No such file or directory")  # the error without /dev/shm

_multiprocessing.SemLock = refuse
import {module}
"""


def import_without_semaphores(module: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", "-c", NO_SEMAPHORES.format(module=module)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("module", ["decompose.engines.parallelobox.attempts", "decompose.best"])
def test_planning_needs_no_semaphores(module: str) -> None:
    result = import_without_semaphores(module)
    assert (result.returncode, result.stderr) == (0, "")


def test_joblib_warns_without_the_filter() -> None:
    """Check that joblib warns without the filter, so that the test above is meaningful."""
    assert "serial mode" in import_without_semaphores("joblib").stderr
