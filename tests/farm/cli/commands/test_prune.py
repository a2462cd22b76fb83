"""Output of `farm prune`, as text and as JSON."""

import json

import pytest

from farm import api
from farm.cli.client import Client
from farm.cli.main import main

RESPONSE = api.PruneResponse(
    dry_run=True,
    jobs=[
        api.PrunedJob(id=3, name="bunny.stl", size_bytes=480_000_000),
        api.PrunedJob(id=4, name="gear.3mf", size_bytes=20_000_000),
    ],
    freed_bytes=490_000_000,
    stored_bytes=44_000_000_000,
    events=1,
)


@pytest.fixture
def run_prune(monkeypatch, capsys, tmp_path):
    """Run `farm prune` with a recording daemon; return its requests and the output."""
    requests = []

    def record_request(self, dry_run):
        requests.append(dry_run)
        return RESPONSE.model_copy(update={"dry_run": dry_run})

    monkeypatch.setattr(Client, "prune", record_request)

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["farm", "prune", "--state", str(tmp_path), *arguments])
        with pytest.raises(SystemExit) as exit_error:
            main()
        assert exit_error.value.code == 0
        return requests, capsys.readouterr().out

    return run


def test_dry_run_describes_what_would_be_deleted(run_prune):
    requests, text = run_prune("--dry-run")
    assert requests == [True]
    assert text.splitlines() == [
        "job 3  0.48 GB  bunny.stl",
        "job 4  0.02 GB  gear.3mf",
        "2 jobs would be pruned: 0.49 GB freed, 44.00 GB kept, 1 old event deleted",
    ]


def test_prune_describes_what_was_deleted(run_prune):
    requests, text = run_prune()
    assert requests == [False]
    assert text.splitlines()[-1].startswith("2 jobs pruned: 0.49 GB freed")


def test_json_of_a_prune_has_the_same_figures(run_prune):
    _, text = run_prune("--json", "--dry-run")
    assert json.loads(text) == RESPONSE.model_dump(by_alias=True)
