"""Replanning of waiting plates (coordinator, plate_replanner), and of jobs before their start (revisions)."""

from farm.planning.replanning.coordinator import ReplanCoordinator, StartReplan
from farm.planning.replanning.plate_replanner import PlateReplanner
from farm.planning.replanning.replan import ReplannedPlate, ReplanTask
from farm.planning.replanning.revisions import PlanRevisions

__all__ = [
    "PlanRevisions",
    "PlateReplanner",
    "ReplanCoordinator",
    "ReplanTask",
    "ReplannedPlate",
    "StartReplan",
]
