"""Replanning of waiting plates: policy, coordinator and worker."""

from farm.planning.replanning.coordinator import ReplanCoordinator, StartReplan
from farm.planning.replanning.replan import ReplannedPlate, ReplanTask
from farm.planning.replanning.worker import ReplanWorker

__all__ = [
    "ReplanCoordinator",
    "ReplanTask",
    "ReplanWorker",
    "ReplannedPlate",
    "StartReplan",
]
