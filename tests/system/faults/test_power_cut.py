"""Power cuts, after which only synced data is on the disk; it must be complete."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.records import JOURNAL, Journal
from farm.state.storage.file_store import compute_sha256, store_file
from farm.state.storage.store import Store
from hosts.power_cut import PowerCut

C_COMPILER = shutil.which("cc")
SHIM_SOURCE = Path(__file__).parents[2] / "support" / "hosts" / "sync_recorder.c"
COMMIT_SCRIPT = """
import sys
from pathlib import Path
from farm.state.books import Books
from farm.state.transitions import apply
from farm.state.storage.store import Store
from books.make_books import make_fleet_events, make_job
from farm.state import events as ev

store, books = Store(Path(sys.argv[1])), Books()
for event in (*make_fleet_events(), ev.JobSubmitted(at_s=0.0, job=make_job())):
    new_books, _ = apply(event, books)
    store.commit(event, books, new_books)
    books = new_books
    print(type(event).__name__, flush=True)
    sys.stdin.readline()
"""


@pytest.mark.parametrize("is_new", [True, False])
def test_journal_keeps_every_record_that_the_agent_acted_on(tmp_path, monkeypatch, is_new):
    folder = tmp_path / "agent"
    folder.mkdir()
    if not is_new:
        Journal(folder / JOURNAL).write(0.0, filament="at_nozzle")
    disk = PowerCut(monkeypatch, folder)
    journal = Journal(folder / JOURNAL)
    for number, phase in enumerate((m.PrintPhase.SPOOLED, m.PrintPhase.PRINTING, m.PrintPhase.DONE)):
        print_snapshot = m.PrintSnapshot(print_id="p-1", phase=phase)
        journal.write(
            float(number), print=print_snapshot.model_dump(mode="json"), filament="parked", hot=number < 2
        )
        surviving_state = Journal(disk.copy_synced_files(tmp_path / f"left-{number}") / JOURNAL).state
        assert (surviving_state.print, surviving_state.filament, surviving_state.board.hot) == (
            print_snapshot,
            m.Filament.PARKED,
            number < 2,
        )
    assert surviving_state.ended_print_ids == {"p-1"}


@pytest.mark.parametrize("suffix", [".gcode", ".stl"])
def test_stored_file_is_complete(tmp_path, monkeypatch, suffix):
    folder = tmp_path / "state"
    (folder / "files").mkdir(parents=True)
    (folder / "work").mkdir()
    disk = PowerCut(monkeypatch, folder)
    source = folder / "work" / f"made{suffix}"
    source.write_bytes(os.urandom(100_000))
    name = store_file(folder / "files", source)
    surviving_file = disk.copy_synced_files(tmp_path / "left") / "files" / name
    assert compute_sha256(surviving_file) + suffix == name


def test_database_is_synced_at_every_commit(tmp_path):
    with Store(tmp_path / "farm.db") as store:
        assert store._db.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL
        assert store._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)


@pytest.mark.skipif(C_COMPILER is None, reason="needs a C compiler")
def test_database_keeps_every_committed_event(tmp_path):
    """Record the syncs of SQLite with a library that is loaded before libc."""
    shim, synced_folder, books = tmp_path / "synced.so", tmp_path / "synced", tmp_path / "state" / "farm.db"
    subprocess.run([C_COMPILER, "-shared", "-fPIC", "-o", shim, SHIM_SOURCE, "-ldl"], check=True)
    synced_folder.mkdir()
    books.parent.mkdir()
    env = {**os.environ, "LD_PRELOAD": str(shim), "SYNCED_TO": str(synced_folder)}
    env["PYTHONPATH"] = os.pathsep.join((str(SHIM_SOURCE.parents[1]), str(SHIM_SOURCE.parents[3])))
    command = [sys.executable, "-c", COMMIT_SCRIPT, str(books)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=env, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        committed_events: list[str] = []
        while message := process.stdout.readline().strip():
            committed_events.append(message)
            surviving_folder = tmp_path / f"left-{len(committed_events)}"
            surviving_folder.mkdir()
            for file in synced_folder.iterdir():
                if (books.parent / file.name).exists():  # SQLite deletes a journal only after its sync
                    shutil.copy(file, surviving_folder)
            with Store(surviving_folder / "farm.db") as store:
                assert [kind for _, kind, _ in store.read_all_events()] == committed_events
                printers, jobs = store.load().printers, store.load().jobs
                assert len(printers) + len(jobs) == len(committed_events)
                assert all(json.loads(body) for _, _, body in store.read_all_events())
            process.stdin.write("\n")
            process.stdin.flush()
    assert process.returncode == 0
    assert committed_events[-1] == "JobSubmitted"
