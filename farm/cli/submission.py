"""Submissions of models: upload each, follow its job or show its plan, and report the result."""

from __future__ import annotations

import glob
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from farm import api
from farm.cli.client import Client
from farm.cli.display import (
    follow_job,
    print_json,
    retry_during_restart,
    show_progress,
    show_result,
    show_submitted_job,
    show_timeline,
    show_upload,
)
from farm.cli.notices import print_notice
from farm.errors import ErrorCode, ExitCode, FarmError, RefusedError
from farm.model import JobOptions, JobState

_POLL_INTERVAL_S = 0.5


@dataclass(frozen=True, slots=True)
class Submitter:
    """Submitter of models to the daemon, with the same options for all models.

    Attributes
    ----------
    wait
        True to follow each job to its end.
    quiet
        True to print only JSON on stdout.
    """

    client: Client
    options: JobOptions
    wait: bool
    quiet: bool

    def submit_model(self, model: Path) -> int:
        """Submit one model and show its job; return the exit code. Raises FarmError."""
        response = self._show_job_or_plan(self._upload_model(model))
        if self.quiet:
            print_json(response)
        return _find_exit_code(response)

    def submit_models(self, models: Iterable[Path]) -> int:
        """Submit several models, one job for each; a failure does not stop the others.

        Returns
        -------
        int
            Exit code of the first failed model; `ExitCode.DONE` if none failed.
        """
        submissions = [api.Submission(model=str(model)) for model in models]
        numbers: dict[int, int] = {}
        for i, submission in enumerate(submissions):
            try:
                numbers[i] = self._upload_model(Path(submission.model))
                # Dry runs are finished one by one, because the daemon cancels those that no client polls.
                if self.options.dry_run:
                    submissions[i] = self._finish_submission(submission, numbers.pop(i))
            except FarmError as error:
                submissions[i] = _record_failure(submission, error)
        for i, number in numbers.items():
            try:
                submissions[i] = self._finish_submission(submissions[i], number)
            except FarmError as error:
                submissions[i] = _record_failure(submissions[i], error)
        if self.quiet:
            print_json(api.Submissions(submissions=submissions))
        failures = [submission for submission in submissions if submission.exit_code]
        if failures:
            print_notice(f"{len(failures)} of {len(submissions)} models failed")
        return failures[0].exit_code if failures else int(ExitCode.DONE)

    def _finish_submission(self, submission: api.Submission, number: int) -> api.Submission:
        """Show a submitted job or its plan; return the submission with that job or plan."""
        response = self._show_job_or_plan(number)
        if isinstance(response, api.Timeline):
            return submission.model_copy(update={"timeline": response})
        return submission.model_copy(update={"job": response.job, "exit_code": response.job.exit_code})

    def _upload_model(self, model: Path) -> int:
        """Upload a model and return the number of its job."""
        if not model.is_file():
            problem = "is a folder" if model.is_dir() else "no such file"
            raise FarmError(f"{model}: {problem}; give the file of a model", ErrorCode.MODEL)
        try:
            with show_upload(self.quiet) as report:
                response = self.client.submit(model, self.options, report=report)
        except KeyboardInterrupt:
            print_notice(
                f"{model.name} may have been submitted: check `farm status` before you submit it again"
            )
            raise
        for notice in response.notices:
            print_notice(notice)
        return response.job

    def _show_job_or_plan(self, number: int) -> api.JobStatus | api.Timeline:
        return self._show_plan(number) if self.options.dry_run else self._show_job(number)

    def _show_job(self, number: int) -> api.JobStatus:
        """Show a submitted job; with `wait`, follow it to its end."""
        response = self.client.fetch_job(number)
        if not self.quiet:
            show_submitted_job(response.job, self.wait)
        if self.wait:
            try:
                response = follow_job(self.client, number, quiet=self.quiet)
            except KeyboardInterrupt:
                print_notice(f"job {number} continues; `farm status {number}` shows its progress")
                raise
        if not self.quiet and self.wait and (response.job.parts or not response.job.exit_code):
            show_result(response.job)
        if response.job.exit_code and response.job.reason:
            print_notice(f"job {number}: {response.job.reason}")
        return response

    def _show_plan(self, number: int) -> api.Timeline:
        """Show the timeline of a planned job, and cancel the job, even after an error."""
        try:
            with show_progress(number, quiet=self.quiet) as update:
                while True:
                    job = retry_during_restart(lambda: self.client.fetch_job(number)).job
                    if job.state not in (JobState.QUEUED, JobState.PLANNING):
                        break
                    update(job)
                    if job.waits_for_person and job.hold is not None:
                        raise RefusedError(f"job {number} cannot be planned now: {job.hold.text}")
                    time.sleep(_POLL_INTERVAL_S)
            if job.exit_code:
                code = ErrorCode(job.error) if job.error else ErrorCode.FAILED
                raise FarmError(f"job {job.id}: {job.reason or job.state}", code)
            timeline = self.client.fetch_timeline(number)
        finally:
            if not JobState(self.client.fetch_job(number).job.state).ended:
                self.client.cancel_job(number)
        if not self.quiet:
            show_timeline(timeline)
        return timeline


def expand_patterns(models: Iterable[Path]) -> list[Path]:
    """Replace each glob pattern with the matching files, sorted by name; an existing path is no pattern."""
    paths: list[Path] = []
    for model in models:
        matches: list[Path] = []
        if glob.has_magic(str(model)) and not model.exists():
            matches = sorted(Path(model.anchor).glob(str(model.relative_to(model.anchor))))
        paths += matches or [model]
    return paths


def _find_exit_code(response: api.JobStatus | api.Timeline) -> int:
    return response.job.exit_code if isinstance(response, api.JobStatus) else int(ExitCode.DONE)


def _record_failure(submission: api.Submission, error: FarmError) -> api.Submission:
    """Print the error of one model among several; return the submission with that error."""
    text, name = " ".join(str(error).split()), Path(submission.model).name
    print_notice(text if name in text else f"{name}: {text}")
    return submission.model_copy(update={"error": text, "exit_code": int(error.exit_code)})
