"""What an agent keeps on its disk."""

import errno
import hashlib
import json
import os
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.agent.spool import Spool
from drivers.errors import AgentError, BadGcode, JournalError, Unreadable
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from drivers.records.board_state import BoardState
from drivers.records.journal import Journal


def test_a_journal_cut_short_is_read_to_its_last_whole_record(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    ended = m.PrintSnapshot(print_id="p-1", phase=m.PrintPhase.DONE)
    opened = m.PrintSnapshot(print_id="p-2", phase=m.PrintPhase.HEATING)
    journal = Journal(path)
    journal.write(1.0, print=ended.model_dump(mode="json"), filament="parked")
    journal.write(2.0, print=opened.model_dump(mode="json"), look="smoke")
    with path.open("ab") as end:
        end.write(b'{"at_s": 3.0, "print": nu')
    memory = Journal(path).memory
    assert memory.print == opened
    assert (list(memory.late), memory.filament, memory.board.attention_reason) == (
        [ended],
        m.Filament.PARKED,
        "smoke",
    )
    Journal(path).write(4.0, look=None)
    assert Journal(path).memory.board.attention_reason is None


def test_a_journal_on_a_full_disk_says_so_and_keeps_its_lines_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.write(1.0, filament="parked")
    write = os.write
    with monkeypatch.context() as full:
        full.setattr(os, "write", lambda fd, data: write(fd, data[:7]))  # as the last free bytes take it
        with pytest.raises(JournalError, match="disk"):
            journal.write(2.0, filament="at_nozzle")
    assert journal.memory.filament is m.Filament.PARKED
    journal.write(3.0, look="smoke")
    memory = Journal(path).memory
    assert (memory.filament, memory.board.attention_reason) == (m.Filament.PARKED, "smoke")


def test_a_damaged_journal_is_read_as_far_as_it_goes_and_a_person_has_to_look(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    ended = m.PrintSnapshot(print_id="p-1", phase=m.PrintPhase.DONE)
    Journal(path).write(1.0, filament="parked")
    with path.open("ab") as end:
        end.write(b'\x00\x00\x00{"at_s": 2.0\n{"at_s": 3.0, "print": {"colour": 1}}\n5\n[]\n')
    assert Journal(path).memory.heat  # one of them may have begun a print
    Journal(path).write(4.0, print=ended.model_dump(mode="json"))
    memory = Journal(path).memory
    assert memory.ended == {"p-1"} and not memory.heat
    assert memory.board.attention_reason is not None and "journal" in memory.board.attention_reason
    with path.open("ab") as end:
        end.write(b"?\n")
    assert Journal(path).memory.heat
    Journal(path).write(4.5, hot=False)  # it was seen off
    assert not Journal(path).memory.heat
    Journal(path).write(5.0, look=None)  # a person did
    assert Journal(path).memory.board.attention_reason is None


def test_the_spool_keeps_a_checked_copy(tmp_path: Path):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    spool = Spool(tmp_path / "spool", ULTIMAKER2_PLUS)
    program = spool.take("p-1", source, hashlib.sha256(b"G28\n").hexdigest())
    assert program.count == 1
    assert (tmp_path / "spool" / "p-1.gcode").read_bytes() == b"G28\n"
    source.unlink()
    spool.drop("p-1")
    spool.drop("p-1")
    assert os.listdir(tmp_path / "spool") == []  # noqa: PTH208
    assert program.lines(0, 1) == [b"G28"]  # whoever prints has it still
    source.write_bytes(b"M0\n")
    with pytest.raises(BadGcode, match="knob"):
        spool.take("p-1", source, hashlib.sha256(b"M0\n").hexdigest())
    with pytest.raises(BadGcode, match="sha256"):
        spool.take("p-1", source, "0" * 64)
    with pytest.raises(BadGcode, match="cannot be read"):
        spool.take("p-1", tmp_path / "none", "0" * 64)
    with pytest.raises(AgentError):
        spool.check("../p-1")


def test_a_full_disk_keeps_no_half_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    spool = Spool(tmp_path / "spool", ULTIMAKER2_PLUS)

    class Full:
        def update(self, _: bytes) -> None:
            raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(hashlib, "sha256", Full)
    with pytest.raises(AgentError, match="make room"):
        spool.take("p-1", source, "0" * 64)
    assert not list((tmp_path / "spool").iterdir())


def test_a_file_may_come_over_the_socket_in_pieces(tmp_path: Path):
    spool = Spool(tmp_path, ULTIMAKER2_PLUS)
    text = b"G28\n" * 100
    for at in (0, 64, 0, 64, 128):  # begun anew after a break
        spool.put("p-1", at, text[at : at + 64])
    with pytest.raises(AgentError, match="follow"):
        spool.put("p-1", 128, b"G28\n")
    spool.put("p-1", 192, text[192:])
    program = spool.take("p-1", spool.part("p-1"), hashlib.sha256(text).hexdigest())
    assert program.count == 100
    spool.put("p-2", 0, b"left")
    Spool(tmp_path, ULTIMAKER2_PLUS)
    assert not spool.part("p-2").exists()
    with pytest.raises(AgentError):
        spool.put("../p", 0, b"")


def test_a_copy_that_is_written_over_is_not_printed(tmp_path: Path):
    source = tmp_path / "a.gcode"
    source.write_bytes(b"G28\n")
    program = Spool(tmp_path / "spool", ULTIMAKER2_PLUS).take(
        "p-1", source, hashlib.sha256(b"G28\n").hexdigest()
    )
    (tmp_path / "spool" / "p-1.gcode").write_bytes(b"G29\n")
    with pytest.raises(Unreadable):
        program.lines(0, 1)


def test_the_board_s_state_is_journalled_whole_under_its_first_names(tmp_path):
    path = tmp_path / "journal.jsonl"
    state = BoardState.model_validate(
        {"look": "smoke", "doubt": "moved", "hot": True, "reset_verified": "/dev/a"}
    )
    Journal(path).write(1.0, **state.record())
    record = json.loads(path.read_text())
    assert record == {
        "at_s": 1.0,
        "look": "smoke",
        "doubt": "moved",
        "hot": True,
        "opened": None,
        "reset_verified": "/dev/a",
        "reset_refuted": None,
    }
    assert Journal(path).memory.board == state


def test_a_record_of_some_of_the_board_s_state_keeps_the_rest(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"at_s": 1.0, "doubt": "moved", "hot": true}\n{"at_s": 2.0, "look": "smoke"}\n')
    board = Journal(path).memory.board
    assert (board.attention_reason, board.bed_unknown_reason, board.hot) == ("smoke", "moved", True)


def test_a_snapshot_keeps_the_names_of_the_wire():
    said = m.Snapshot(printer="a", agent_pid=1, link=m.LinkState.READY, bed_unknown_reason="moved")
    line = json.loads(said.model_dump_json())
    assert line["doubt"] == "moved" and "bed_unknown_reason" not in line
    assert m.from_agent_adapter.validate_json(json.dumps(line)) == said
