"""The agent's copies of G-code files."""

import errno
import hashlib
import os
from pathlib import Path

import pytest

from drivers.agent.spool import Spool
from drivers.errors import AgentError, BadGcode, UnreadableFile
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS


def test_spool_keeps_a_checked_copy(tmp_path: Path):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    spool = Spool(tmp_path / "spool", ULTIMAKER2_PLUS)
    program = spool.import_gcode("p-1", source, hashlib.sha256(b"G28\n").hexdigest())
    assert program.line_count == 1
    assert (tmp_path / "spool" / "p-1.gcode").read_bytes() == b"G28\n"
    source.unlink()
    spool.delete("p-1")
    spool.delete("p-1")
    assert os.listdir(tmp_path / "spool") == []  # noqa: PTH208
    assert program.read_lines(0, 1) == [b"G28"]  # a running print keeps its open file
    source.write_bytes(b"M0\n")
    with pytest.raises(BadGcode, match="knob"):
        spool.import_gcode("p-1", source, hashlib.sha256(b"M0\n").hexdigest())
    with pytest.raises(BadGcode, match="sha256"):
        spool.import_gcode("p-1", source, "0" * 64)
    with pytest.raises(BadGcode, match="cannot be read"):
        spool.import_gcode("p-1", tmp_path / "none", "0" * 64)
    with pytest.raises(AgentError):
        spool.check_print_id("../p-1")


def test_full_disk_leaves_no_partial_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    spool = Spool(tmp_path / "spool", ULTIMAKER2_PLUS)

    class FullDiskHash:
        def update(self, _: bytes) -> None:
            raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(hashlib, "sha256", FullDiskHash)
    with pytest.raises(AgentError, match="make room"):
        spool.import_gcode("p-1", source, "0" * 64)
    assert not list((tmp_path / "spool").iterdir())


def test_file_is_received_in_pieces_over_the_socket(tmp_path: Path):
    spool = Spool(tmp_path, ULTIMAKER2_PLUS)
    text = b"G28\n" * 100
    for offset in (0, 64, 0, 64, 128):  # the upload restarts after an interruption
        spool.append_upload("p-1", offset, text[offset : offset + 64])
    with pytest.raises(AgentError, match="follow"):
        spool.append_upload("p-1", 128, b"G28\n")
    spool.append_upload("p-1", 192, text[192:])
    program = spool.import_gcode("p-1", spool.make_upload_path("p-1"), hashlib.sha256(text).hexdigest())
    assert program.line_count == 100
    spool.append_upload("p-2", 0, b"left")
    Spool(tmp_path, ULTIMAKER2_PLUS)
    assert not spool.make_upload_path("p-2").exists()
    with pytest.raises(AgentError):
        spool.append_upload("../p", 0, b"")


def test_overwritten_copy_is_not_printed(tmp_path: Path):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    program = Spool(tmp_path / "spool", ULTIMAKER2_PLUS).import_gcode(
        "p-1", source, hashlib.sha256(b"G28\n").hexdigest()
    )
    (tmp_path / "spool" / "p-1.gcode").write_bytes(b"G29\n")
    with pytest.raises(UnreadableFile):
        program.read_lines(0, 1)


def test_files_of_all_other_prints_are_deleted(tmp_path: Path):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    spool = Spool(tmp_path / "spool", ULTIMAKER2_PLUS)
    sha256 = hashlib.sha256(b"G28\n").hexdigest()
    printing_program = spool.import_gcode("p-1", source, sha256)
    spool.append_upload("p-2", 0, b"G28\n")  # an upload whose print was never started
    spool.import_gcode("p-3", source, sha256)
    assert [path.name for path in (tmp_path / "spool").iterdir()] == ["p-3.gcode"]
    assert printing_program.read_lines(0, 1) == [b"G28"]
    spool.delete_others(None)
    assert not list((tmp_path / "spool").iterdir())
