"""Engine `best`: the engine `guillotine` on several grids and at several angles, in rounds of attempts."""

from decompose.best.attempt import Outcome, PlannedAttempt, make_attempt, rotate_about_z
from decompose.best.progress import listen_to_progress, report_progress
from decompose.best.rounds import SearchState, choose_first_granularity, plan_next_round
from decompose.best.search import continue_rounds, end_rounds, find_best_result

__all__ = [
    "Outcome",
    "PlannedAttempt",
    "SearchState",
    "choose_first_granularity",
    "continue_rounds",
    "end_rounds",
    "find_best_result",
    "listen_to_progress",
    "make_attempt",
    "plan_next_round",
    "report_progress",
    "rotate_about_z",
]
