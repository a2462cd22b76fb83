"""Journal of the agent, including journals that older agents wrote."""

import errno
import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import messages as m
from drivers.errors import JournalError
from drivers.records import Alarm, BoardState, Journal, JournalState


def test_truncated_journal_is_read_to_its_last_complete_record(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    ended_print = m.PrintSnapshot(print_id="p-1", phase=m.PrintPhase.DONE)
    open_print = m.PrintSnapshot(print_id="p-2", phase=m.PrintPhase.HEATING)
    journal = Journal(path)
    journal.write(1.0, print=ended_print.model_dump(mode="json"), filament="parked")
    journal.write(2.0, print=open_print.model_dump(mode="json"), look="smoke")
    with path.open("ab") as file:
        file.write(b'{"at_s": 3.0, "print": nu')
    loaded_state = Journal(path).state
    assert loaded_state.print == open_print
    assert (list(loaded_state.recent_prints), loaded_state.filament, loaded_state.board.attention_reason) == (
        [ended_print],
        m.Filament.PARKED,
        "smoke",
    )
    Journal(path).write(4.0, look=None)
    assert Journal(path).state.board.attention_reason is None


def test_full_disk_fails_the_write_and_keeps_the_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.write(1.0, filament="parked")
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: write(fd, data[:7]))  # like a disk with 7 free bytes
        with pytest.raises(JournalError, match="check its disk"):
            journal.write(2.0, filament="at_nozzle")
    assert journal.state.filament is m.Filament.PARKED
    journal.write(3.0, look="smoke")
    loaded_state = Journal(path).state
    assert (loaded_state.filament, loaded_state.board.attention_reason) == (m.Filament.PARKED, "smoke")


def test_damaged_journal_needs_attention_and_may_leave_the_printer_hot(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    ended_print = m.PrintSnapshot(print_id="p-1", phase=m.PrintPhase.DONE)
    Journal(path).write(1.0, filament="parked")
    with path.open("ab") as file:
        file.write(b'\x00\x00\x00{"at_s": 2.0\n{"at_s": 3.0, "print": {"colour": 1}}\n5\n[]\n')
    assert Journal(path).state.may_be_hot  # one of the damaged records may have begun a print
    Journal(path).write(4.0, print=ended_print.model_dump(mode="json"))
    loaded_state = Journal(path).state
    assert loaded_state.ended_print_ids == {"p-1"} and not loaded_state.may_be_hot
    assert (
        loaded_state.board.attention_reason is not None and "journal" in loaded_state.board.attention_reason
    )
    with path.open("ab") as file:
        file.write(b"?\n")
    assert Journal(path).state.may_be_hot
    Journal(path).write(4.5, hot=False)  # the heaters were seen to be off
    assert not Journal(path).state.may_be_hot
    Journal(path).write(5.0, look=None)  # a person has inspected the printer
    assert Journal(path).state.board.attention_reason is None


def test_board_state_is_written_completely_under_its_original_names(tmp_path):
    path = tmp_path / "journal.jsonl"
    state = BoardState.model_validate(
        {"look": "smoke", "doubt": "moved", "hot": True, "reset_verified": "/dev/a"}
    )
    Journal(path).write(1.0, **state.dump_record())
    record = json.loads(path.read_text())
    assert record == {
        "at_s": 1.0,
        "look": "smoke",
        "doubt": "moved",
        "hot": True,
        "rest": None,
        "opened": None,
        "reset_verified": "/dev/a",
        "reset_refuted": None,
    }
    assert Journal(path).state.board == state


def test_partial_record_of_the_board_keeps_its_other_fields(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"at_s": 1.0, "doubt": "moved", "hot": true}\n{"at_s": 2.0, "look": "smoke"}\n')
    board = Journal(path).state.board
    assert (board.attention_reason, board.bed_unknown_reason, board.hot) == ("smoke", "moved", True)


def test_snapshot_keeps_the_names_of_its_fields_in_messages():
    snapshot = m.Snapshot(printer="a", agent_pid=1, link=m.LinkState.READY, bed_unknown_reason="moved")
    line = json.loads(snapshot.model_dump_json())
    assert line["doubt"] == "moved" and "bed_unknown_reason" not in line
    assert m.from_agent_adapter.validate_json(json.dumps(line)) == snapshot


def test_alarm_is_written_and_read_under_its_original_names(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"at_s": 1.0, "alarm": {"text": "hot", "at_s": 1.0, "asked": true, "said": null}}\n')
    alarm = Journal(path).state.alarm
    assert alarm == Alarm(text="hot", at_s=1.0, power_off_requested=True) and alarm.is_pending
    cut_alarm = alarm.model_copy(update={"outcome": "off"})
    Journal(path).write(2.0, alarm=cut_alarm.dump_record())
    last_record = json.loads(path.read_text().splitlines()[-1])
    assert last_record["alarm"] == {"text": "hot", "at_s": 1.0, "asked": True, "said": "off", "over": False}


_snapshots = st.builds(
    m.PrintSnapshot,
    print_id=st.integers(0, 30).map("p-{}".format),
    phase=st.sampled_from(m.PrintPhase),
    ended_s=st.none() | st.floats(0, 1e9),
)
_records = st.fixed_dictionaries(
    {},
    optional={
        "print": st.none() | _snapshots.map(lambda snapshot: snapshot.model_dump(mode="json")),
        "filament": st.sampled_from([filament.value for filament in m.Filament]),
        "alarm": st.none() | st.just(Alarm(text="hot", at_s=4.0).dump_record()),
        "look": st.none() | st.just("smoke"),
        "hot": st.booleans(),
        "identity": st.none() | st.just("serial-7"),
    },
)


@given(records=st.lists(_records, max_size=40))
def test_shortened_journal_restores_the_same_state(records: list[dict[str, object]]):
    old_state = JournalState()
    for record in records:
        old_state.apply(record)
    new_state = JournalState()
    for record in old_state.list_records():
        new_state.apply(json.loads(json.dumps(record)))
    assert new_state == old_state


def test_long_journal_is_shortened_and_the_old_one_is_kept_once(tmp_path: Path):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    for number in range(1, 1300):
        ended_print = m.PrintSnapshot(print_id=f"p-{number}", phase=m.PrintPhase.DONE, ended_s=float(number))
        journal.state.apply({"print": ended_print.model_dump(mode="json")})
    journal.write(1300.0, print=None, filament="parked")
    assert not journal.shorten()  # the file itself is short
    assert journal.shorten(max_bytes=10)
    journal.write(1301.0, filament="at_nozzle")
    state = Journal(path).state
    assert (len(state.recent_prints), state.filament) == (1000, m.Filament.AT_NOZZLE)
    assert state.recent_prints[-1].print_id == "p-1299" and "p-1299" in state.ended_print_ids
    assert '"parked"' in (tmp_path / "journal.jsonl.1").read_text()
    journal.shorten(max_bytes=10)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["journal.jsonl", "journal.jsonl.1"]


@pytest.mark.parametrize("broken_call", ["write", "fsync", "link", "replace"])
def test_journal_that_cannot_be_shortened_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken_call: str
):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.write(1.0, filament="parked")

    def fail(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(*((Path, "replace") if broken_call == "replace" else (os, broken_call)), fail)
        assert not journal.shorten(max_bytes=10)
    journal.write(2.0, look="smoke")
    state = Journal(path).state
    assert (state.filament, state.board.attention_reason) == (m.Filament.PARKED, "smoke")
