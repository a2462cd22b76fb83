"""Planning on a machine without semaphores."""

import subprocess
import sys

import pytest

NO_SEMAPHORES = """
import _multiprocessing

def refuse(*_, **__):
    raise FileNotFoundError(2, "No such file or directory")  # as it is without /dev/shm

_multiprocessing.SemLock = refuse
import {module}
"""


def import_without_semaphores(module: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", "-c", NO_SEMAPHORES.format(module=module)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("module", ["decompose.engines.parallelobox.attempts", "decompose.best"])
def test_planning_needs_no_semaphores(module: str) -> None:
    done = import_without_semaphores(module)
    assert (done.returncode, done.stderr) == (0, "")


def test_joblib_warns_without_the_filter() -> None:
    """Without the filter joblib warns, which makes the test above meaningful."""
    assert "serial mode" in import_without_semaphores("joblib").stderr
