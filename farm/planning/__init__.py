"""Planning of jobs: a submitted model becomes parts, and each part a plate for one printer.

Its modules, in the order in which a job passes through them:

1. `inspection`: read and check a submission, before its job is accepted.
2. `job_planner`: plan several jobs concurrently, on the event loop. `plan_builder` runs the steps of one
   plan. The functions in `tasks` run in workers.
3. `parts.decompose_job`: cut the model for its printers. With a large budget, `parts.search_rounds` runs
   several attempts of the search in parallel.
4. `slice_batch`, `parts.slice_part`: slice every part.
5. `parts.rebalance_parts`: move the cuts if the slices show that one part is too slow.
6. `plan_storage`: put the files into the store; `planned_event`: the event that commits the plan.

`plan` and `part_records` define the records that pass between these steps. `replanning` plans waiting plates
again, and jobs before their start; `local` is `farm decompose` and `farm slice`, without a daemon.
"""

from farm.planning.job_planner import JobPlanner
from farm.planning.plan import (
    InspectedSubmission,
    Plan,
    PlanRequest,
    TooFewPrinters,
    make_inspection_step_path,
)
from farm.planning.plan_storage import list_job_files
from farm.planning.planned_event import build_planned_event
from farm.planning.printer_settings import list_bed_boxes

__all__ = [
    "InspectedSubmission",
    "JobPlanner",
    "Plan",
    "PlanRequest",
    "TooFewPrinters",
    "build_planned_event",
    "list_bed_boxes",
    "list_job_files",
    "make_inspection_step_path",
]
