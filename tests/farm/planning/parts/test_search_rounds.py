"""Rounds of a search in the workers: attempts side by side, their limits, failures and progress."""

import asyncio
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.errors import ErrorCode, FarmError
from farm.planning.decompose_progress import ProgressFile
from farm.planning.parts.search_rounds import SearchRounds
from farm.planning.plan import DecomposeTask, PausedDecomposition
from farm.planning.tasks import continue_job, decompose_job, make_attempt

DECOMPOSED = "decomposed"


class ScriptedWorkers:
    """Workers that answer each task at once, but attempts in a given order, or with an error."""

    def __init__(self, folder, rounds=(3,), order=(), errors=None, continue_errors=()):
        self.paused_decompositions = [
            PausedDecomposition(folder / f"search-{n}.pickle", n, 0.25) for n in rounds
        ]
        self.order, self.errors = list(order), errors or {}
        self.order_changed = asyncio.Condition()
        self.running_count, self.max_running_count, self.cancelled_attempts = 0, 0, []
        self.outcomes, self.end_reasons = [], []
        self.continue_errors = list(continue_errors)

    async def run(self, work, task, *args, limit=None):
        if work is make_attempt:
            return await self.make_attempt(*args)
        assert work is (continue_job if args else decompose_job)
        if args:
            self.outcomes.append(args[1])
            self.end_reasons.append(args[2] if len(args) > 2 else None)
            if self.continue_errors:
                raise self.continue_errors.pop(0)
        return self.paused_decompositions.pop(0) if self.paused_decompositions else DECOMPOSED

    async def make_attempt(self, record, number, folder):
        self.running_count += 1
        self.max_running_count = max(self.max_running_count, self.running_count)
        try:
            await asyncio.sleep(0)
            async with self.order_changed:
                await self.order_changed.wait_for(lambda: not self.order or self.order[0] == number)
                self.order = self.order[1:]
                self.order_changed.notify_all()
            if number in self.errors:
                raise self.errors[number]
            return folder / "outcome.pickle"
        except asyncio.CancelledError:
            self.cancelled_attempts.append(number)
            raise
        finally:
            self.running_count -= 1


def make_task(folder):
    return DecomposeTask(
        job=1, model=folder / "model", options=None, printers=(), round_count=1, folder=folder, may_pause=True
    )


def run_rounds(folder, **script):
    async def main():
        workers = ScriptedWorkers(folder, **script)
        return workers, await SearchRounds(workers, make_task(folder)).run()

    return asyncio.run(main())


@given(order=st.permutations(range(4)))
def test_outcomes_are_collected_in_the_order_of_the_plan(order):
    folder = Path("plan")
    workers, answer = run_rounds(folder, rounds=(4,), order=order)
    assert answer == DECOMPOSED
    assert workers.max_running_count == 4
    assert workers.outcomes == [tuple(folder / f"search-4.{n}" / "outcome.pickle" for n in range(4))]


def test_each_round_has_its_own_folders():
    workers, answer = run_rounds(Path("plan"), rounds=(3, 2))
    assert answer == DECOMPOSED
    files = [file for outcomes in workers.outcomes for file in outcomes]
    assert len(files) == len(set(files)) == 5


def test_attempt_beyond_a_limit_has_no_result():
    error = FarmError("not enough memory for decomposing", ErrorCode.LIMIT)
    workers, answer = run_rounds(Path("plan"), errors={1: error})
    assert answer == DECOMPOSED
    first_outcome, second_outcome, third_outcome = workers.outcomes[0]
    assert second_outcome == "not enough memory for decomposing"
    assert isinstance(first_outcome, Path) and isinstance(third_outcome, Path)


def test_search_beyond_a_limit_ends_with_its_best_result():
    error = FarmError("decomposing did not end within 30 min", ErrorCode.LIMIT)
    workers, answer = run_rounds(Path("plan"), continue_errors=[error])
    assert answer == DECOMPOSED
    assert workers.outcomes[0] == workers.outcomes[1] and len(workers.outcomes) == 2
    assert workers.end_reasons == [None, "not started: decomposing did not end within 30 min"]
    with pytest.raises(FarmError, match="30 min"):
        run_rounds(Path("plan"), continue_errors=[error, error])
    with pytest.raises(FarmError, match="no settings"):
        run_rounds(Path("plan"), continue_errors=[FarmError("no settings")])


def test_another_error_ends_the_other_attempts():
    workers = None

    async def main():
        nonlocal workers
        workers = ScriptedWorkers(Path("plan"), order=[1, 9], errors={1: FarmError("no settings")})
        await SearchRounds(workers, make_task(Path("plan"))).run()

    with pytest.raises(FarmError, match="no settings"):
        asyncio.run(main())
    assert sorted(workers.cancelled_attempts) == [0, 2]
    assert workers.running_count == 0


def test_cancelled_search_ends_all_attempts():
    async def main():
        workers = ScriptedWorkers(Path("plan"), order=[9])
        search_task = asyncio.ensure_future(SearchRounds(workers, make_task(Path("plan"))).run())
        while workers.running_count < 3:
            await asyncio.sleep(0)
        search_task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await search_task
        return workers

    workers = asyncio.run(main())
    assert sorted(workers.cancelled_attempts) == [0, 1, 2]


def test_progress_adds_up_the_attempts(tmp_path):
    async def main():
        workers = ScriptedWorkers(tmp_path, rounds=(2,), order=[9])
        rounds = SearchRounds(workers, make_task(tmp_path))
        assert rounds.read_progress(0.0) is None
        ProgressFile(tmp_path).report(0.25, 0.0)
        assert rounds.read_progress(0.0).share == 0.25
        search_task = asyncio.ensure_future(rounds.run())
        while workers.running_count < 2:
            await asyncio.sleep(0)
        folders = [tmp_path / f"search-2.{number}" for number in range(2)]
        for folder in folders:
            folder.mkdir()
        reports = [rounds.read_progress(10.0)]
        for folder in folders:
            ProgressFile(folder).report(0.25, 0.0)
            reports.append(rounds.read_progress(20.0))
        search_task.cancel()
        await asyncio.gather(search_task, return_exceptions=True)
        return reports

    reports = asyncio.run(main())
    assert [report.share for report in reports] == [0.25, 0.5, 0.75]
    assert [report.remaining_s for report in reports] == [None, pytest.approx(40.0), pytest.approx(10.0)]
