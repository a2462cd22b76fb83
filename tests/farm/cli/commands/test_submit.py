"""`farm submit` of one model and of several, with a daemon in memory."""

import json
from types import SimpleNamespace

import pytest
import typer
from typer.testing import CliRunner

from farm import api
from farm.cli import submission
from farm.cli.commands import submit
from farm.cli.main import app
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, JobState

REFUSAL = "broken.stl: is flat"


class FakeDaemon:
    """Daemon that refuses a model named broken, and fails to plan one named tall."""

    jobs: dict[int, SimpleNamespace]

    def __init__(self, _):
        self.jobs, self.cancelled_jobs = {}, []
        FakeDaemon.instance = self

    def submit(self, model, options, report=None):
        if model.name.startswith("broken"):
            raise FarmError(REFUSAL, ErrorCode.MODEL)
        number = len(self.jobs) + 1
        is_failed = model.name.startswith("tall")
        self.jobs[number] = api.JobView.model_construct(
            id=number,
            name=options.name or model.name,
            options=options,
            state=JobState.FAILED if is_failed else JobState.HELD if options.dry_run else JobState.PRINTED,
            error="no_fit" if is_failed else None,
            reason="does not fit" if is_failed else None,
            exit_code=5 if is_failed else 0,
            hold=None,
            progress=None,
            repairs=[],
            scale=1.0,
            parts=[],
            plates=[],
            printed=0,
            expected_s=None,
            waits_for_person=False,
        )
        return api.SubmitResponse(job=number, again=False)

    def fetch_job(self, number):
        return api.JobStatus.model_construct(job=self.jobs[number])

    def fetch_timeline(self, number):
        return api.Timeline(
            job=number,
            now="2026-01-01T00:00:00+00:00",
            plan="p",
            slots=[],
            left=[],
            notices=[],
            makespan_s=10.0 * number,
            lower_bound_s=0.0,
            grams=1.0,
            price=None,
            currency=None,
        )

    def cancel_job(self, number):
        self.cancelled_jobs.append(number)


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.setattr(submit, "connect", FakeDaemon)
    monkeypatch.setattr(submission, "show_result", lambda view: typer.echo(f"result {view.id}"))
    monkeypatch.setattr(submission, "show_timeline", lambda plan: typer.echo(f"plan {plan.job}"))
    monkeypatch.chdir(tmp_path)
    for name in ("a.stl", "b.stl", "broken.stl", "tall.stl", "c.3mf"):
        (tmp_path / name).write_text("model")

    def run_submit(*arguments):
        return CliRunner().invoke(app, ["submit", *arguments])

    return run_submit


def test_each_model_is_one_job_and_the_first_failure_sets_the_exit_code(run):
    outcome = run("a.stl", "broken.stl", "tall.stl", "b.stl", "missing.stl")
    assert outcome.exit_code == 5
    assert [job.name for job in FakeDaemon.instance.jobs.values()] == ["a.stl", "tall.stl", "b.stl"]
    assert outcome.stdout.count("submitted") == 3
    lines = outcome.stderr.splitlines()
    assert lines[0].endswith(REFUSAL)
    assert "missing.stl: no such file" in lines[1]
    assert "job 2: does not fit" in lines[2]
    assert lines[3].endswith("3 of 5 models failed")
    assert run("a.stl", "b.stl").exit_code == 0


def test_pattern_not_expanded_by_the_shell_is_expanded(run, tmp_path):
    for pattern in ("[ab].stl", str(tmp_path / "[ab].stl")):
        assert run(pattern).exit_code == 0
        assert [job.name for job in FakeDaemon.instance.jobs.values()] == ["a.stl", "b.stl"]
    assert "no such file" in run("z*.stl", "a.stl").stderr
    assert len(FakeDaemon.instance.jobs) == 1


def test_existing_file_named_like_a_pattern_is_not_expanded(run, tmp_path):
    (tmp_path / "[ab].stl").write_text("model")
    run("[ab].stl")
    assert [job.name for job in FakeDaemon.instance.jobs.values()] == ["[ab].stl"]


def test_several_dry_runs_are_shown_one_after_the_other_and_cancelled(run):
    outcome = run("--dry-run", "a.stl", "broken.stl", "tall.stl", "b.stl")
    assert outcome.stdout.splitlines() == ["plan 1", "plan 3"]
    assert FakeDaemon.instance.cancelled_jobs == [1, 3]
    assert outcome.exit_code == 5
    assert "tall.stl: job 2: does not fit" in outcome.stderr
    single_outcome = run("--dry-run", "tall.stl")
    # The entry point prints the error, and exits with its code.
    assert isinstance(single_outcome.exception, FarmError)
    assert (str(single_outcome.exception), single_outcome.exception.exit_code) == ("job 1: does not fit", 5)


def test_json_of_several_models_is_one_object_with_all_outcomes(run):
    outcome = run("--json", "--dry-run", "a.stl", "broken.stl")
    answer = json.loads(outcome.stdout)
    assert answer["schema"] == 1
    first_submission, second_submission = answer["submissions"]
    assert (
        first_submission["model"],
        first_submission["timeline"]["job"],
        first_submission["exit_code"],
    ) == ("a.stl", 1, 0)
    assert (second_submission["model"], second_submission["error"], second_submission["exit_code"]) == (
        "broken.stl",
        REFUSAL,
        5,
    )
    assert "schema" in first_submission["timeline"]


def test_wait_covers_every_submitted_model(run):
    outcome = run("--wait", "a.stl", "b.stl")
    results = [line for line in outcome.stdout.splitlines() if line.startswith("result")]
    assert results == ["result 1", "result 2"]


def test_name_note_and_copies_are_sent_with_the_job(run):
    outcome = run("a.stl", "--name", "  left\tbracket ", "--note", "for\nAda", "--copies", "3")
    assert outcome.exit_code == 0
    assert FakeDaemon.instance.jobs[1].options == JobOptions(name="left bracket", note="for Ada", copies=3)
    assert "left bracket submitted" in outcome.stdout


@pytest.mark.parametrize(
    ("arguments", "expected_text"),
    [
        (("a.stl", "b.stl", "--name", "x"), "--name"),
        (("a.stl", "--copies", "0"), "--copies 0: Input should be greater than or equal to 1"),
        (("a.stl", "--copies", "501"), "--copies 501: Input should be less than or equal to 500"),
        (("a.stl", "--name", "x" * 61), "--name"),
        (("a.stl", "--note", "x" * 201), "--note"),
    ],
)
def test_invalid_option_values_are_refused(run, arguments, expected_text):
    outcome = run(*arguments)
    assert outcome.exit_code
    assert expected_text in outcome.stderr + str(outcome.exception)
