"""Engine `best`: the engine `guillotine` on several grids and at several angles, in rounds of attempts."""

from decompose.best.attempt import Outcome, Trial, make_attempt, rotate_about_z
from decompose.best.rounds import SearchState, choose_first_granularity, plan_next_round
from decompose.best.search import continue_rounds, end_rounds, find_best_result

__all__ = [
    "Outcome",
    "SearchState",
    "Trial",
    "choose_first_granularity",
    "continue_rounds",
    "end_rounds",
    "find_best_result",
    "make_attempt",
    "plan_next_round",
    "rotate_about_z",
]
