"""Logs that are renamed at a size limit while their process and its children write to them."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.log_file import rotate_log

_WRITER = """
import os, sys
from pathlib import Path
from drivers.log_file import rotate_log
path = Path(sys.argv[1])
for number in range(2000):
    print(f"out {number}", flush=True)
    os.write(2, f"err {number}\\n".encode())
    rotate_log(path, 4000, file_count=50)
"""


def test_no_line_of_a_process_is_lost_while_its_log_is_renamed(tmp_path: Path):
    path = tmp_path / "agent.log"
    with path.open("ab") as log:
        subprocess.run([sys.executable, "-c", _WRITER, str(path)], stdout=log, stderr=log, check=True)
    logs = sorted(tmp_path.glob("agent.log*"), key=lambda log: -int(log.suffix[1:]) if log != path else 0)
    assert len(logs) > 5 and logs[-1] == path
    lines = [line for log in logs for line in log.read_text().splitlines()]
    assert lines == [f"{stream} {number}" for number in range(2000) for stream in ("out", "err")]


def test_only_the_newest_logs_are_kept(tmp_path: Path):
    path = tmp_path / "daemon.log"
    for number in range(9):
        path.write_text(f"{number}" * 100)
        assert rotate_log(path, 100, file_count=3)
    results = {log.name: log.read_text()[:1] for log in tmp_path.iterdir()}
    assert results == {"daemon.log": "", "daemon.log.1": "8", "daemon.log.2": "7", "daemon.log.3": "6"}


def test_missing_or_small_log_is_unchanged(tmp_path: Path):
    path = tmp_path / "agent.log"
    assert not rotate_log(path, 100)
    path.write_text("short")
    assert not rotate_log(path, 100)
    assert [log.name for log in tmp_path.iterdir()] == ["agent.log"]


def test_full_disk_leaves_the_log_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "agent.log"
    path.write_text("x" * 100)

    def raise_disk_full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", raise_disk_full)
        assert not rotate_log(path, 100)
    assert path.read_text() == "x" * 100


def test_renamed_log_keeps_its_mode(tmp_path: Path):
    path = tmp_path / "daemon.log"
    path.touch(mode=0o600)
    path.write_text("x" * 100)
    rotate_log(path, 100)
    assert path.stat().st_mode & 0o777 == 0o600
