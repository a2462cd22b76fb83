"""Replanning of waiting plates (coordinator, worker) and of jobs that have not started (revisions)."""

from farm.planning.replanning.coordinator import ReplanCoordinator, StartReplan
from farm.planning.replanning.replan import ReplannedPlate, ReplanTask
from farm.planning.replanning.revisions import PlanRevisions
from farm.planning.replanning.worker import ReplanWorker

__all__ = [
    "PlanRevisions",
    "ReplanCoordinator",
    "ReplanTask",
    "ReplanWorker",
    "ReplannedPlate",
    "StartReplan",
]
