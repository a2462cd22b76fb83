"""Facts collected from an intact or damaged installation of farm 0.1.0, and output of `farm doctor`."""

import json
import os
import sqlite3

import pytest
from typer.testing import CliRunner

from drivers.locks import AGENT_LOCK, acquire_lock
from farm.cli.main import app
from farm.doctor import Level, check_installation, collect_facts
from farm.paths import FarmPaths, StateFolder
from farms.recorded_state import unpack_state


@pytest.fixture
def paths(tmp_path):
    state = unpack_state(tmp_path)
    return FarmPaths(StateFolder(state), tmp_path / "farm.sock", tmp_path / "fleet.yaml")


def list_findings(paths, check):
    result = check_installation(collect_facts(paths, None, "it is down"))
    return [finding for finding in result if finding.check == check]


def test_books_are_read_and_not_changed(paths):
    old_files = {path.name: path.read_bytes() for path in paths.state.root.glob("farm.db*")}
    (books,) = list_findings(paths, "database")
    assert (books.level, "5 jobs" in books.text) == (Level.OK, True)
    new_files = {path.name: path.read_bytes() for path in paths.state.root.glob("farm.db*")}
    assert new_files["farm.db"] == old_files["farm.db"]
    assert new_files["farm.db-count"] == old_files["farm.db-count"]


def test_files_that_are_missing_or_changed_are_named(paths):
    facts = collect_facts(paths, None, None)
    assert facts.files.checked_count > 4  # large ones were omitted from the recording
    kept_file = next(path for path in sorted(paths.state.files.iterdir()) if _is_needed(facts, path.name))
    kept_file.chmod(0o600)
    kept_file.write_bytes(b"other")
    assert any(
        finding.text.endswith(f"{kept_file} has changed since it was planned")
        for finding in list_findings(paths, "files")
    )
    kept_file.unlink()
    assert any(finding.text.endswith(f"{kept_file} is missing") for finding in list_findings(paths, "files"))


def _is_needed(facts, name):
    open_jobs = [job for job in facts.books.books.jobs.values() if not job.state.ended]
    return any(job.model_file == name for job in open_jobs)


def test_row_that_was_changed_is_a_problem(paths):
    with sqlite3.connect(paths.state.books) as db:
        db.execute("UPDATE printer SET body = replace(body, 'clear', 'unknown')")
    db.close()
    (books,) = list_findings(paths, "database")
    assert books.level is Level.PROBLEM and "was changed" in books.text


def test_missing_and_invalid_books_are_reported(paths):
    for path in paths.state.root.glob("farm.db*"):
        path.unlink()
    assert [finding.level for finding in list_findings(paths, "database")] == [Level.OK]
    paths.state.books.write_bytes(b"no books" * 1000)
    assert [finding.level for finding in list_findings(paths, "database")] == [Level.PROBLEM]


def test_silent_agent_is_a_problem(paths):
    lock = acquire_lock(paths.state.find_agent_folder("um2-01") / AGENT_LOCK)
    try:
        (agent,) = (
            finding for finding in list_findings(paths, "agents") if finding.text.startswith("um2-01:")
        )
    finally:
        os.close(lock)
    assert (agent.level, agent.text) == (Level.PROBLEM, "um2-01: its agent is running but does not answer")


def test_command_prints_every_check_and_exits_with_1_on_problems(paths):
    paths.state.books.write_bytes(b"no books" * 1000)
    options = [
        "--state",
        str(paths.state.root),
        "--socket",
        str(paths.socket),
        "--fleet",
        str(paths.fleet),
    ]
    result = CliRunner().invoke(app, ["doctor", "--json", *options])
    answer = json.loads(result.stdout)
    assert (result.exit_code, answer["schema"]) == (1, 1)
    checks = {finding["check"] for finding in answer["findings"]}
    assert {
        "fleet",
        "user",
        "daemon",
        "database",
        "files",
        "agents",
        "cura",
        "code",
        "clock",
        "room",
    } <= checks
    assert all(finding["action"] for finding in answer["findings"] if finding["level"] != "ok")
    lines = CliRunner().invoke(app, ["doctor", *options]).stdout.splitlines()
    assert any(line.startswith("problem  database: ") for line in lines)
    assert any(line.startswith("warning  daemon: ") for line in lines)
