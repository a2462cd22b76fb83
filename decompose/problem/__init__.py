"""Input and output of every engine, and its budget of work."""

from __future__ import annotations

from decompose.problem.effort import WORK_NS, Effort, Work
from decompose.problem.granularity import MAX_GRANULARITY, choose_granularity
from decompose.problem.problem import GridFigures, Partition, Problem, validate_problem
from decompose.problem.similar_poses import keep_similar_poses, measure_similar_pose

__all__ = [
    "MAX_GRANULARITY",
    "WORK_NS",
    "Effort",
    "GridFigures",
    "Partition",
    "Problem",
    "Work",
    "choose_granularity",
    "keep_similar_poses",
    "measure_similar_pose",
    "validate_problem",
]
