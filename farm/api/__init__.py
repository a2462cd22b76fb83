"""Bodies of the daemon's requests and responses; some are also the objects that `--json` prints.

`docs/reference/json.md` describes every field. Times are ISO 8601 in the fleet's time zone, on the farm's
clock; durations are in seconds.
"""

from __future__ import annotations

from pydantic import ConfigDict, Field

from farm.api.base import NETWORK_PREFIX as NETWORK_PREFIX
from farm.api.base import SCHEMA as SCHEMA
from farm.api.base import Line as Line
from farm.api.base import View
from farm.api.events import EventView as EventView
from farm.api.events import JobRow as JobRow
from farm.api.events import Jobs as Jobs
from farm.api.files import FileView as FileView
from farm.api.files import JobFiles as JobFiles
from farm.api.hosts import HostAgentView as HostAgentView
from farm.api.hosts import HostList as HostList
from farm.api.hosts import HostPortView as HostPortView
from farm.api.hosts import HostUpdate as HostUpdate
from farm.api.hosts import HostView as HostView
from farm.api.jobs import JobOverview as JobOverview
from farm.api.jobs import JobSummary as JobSummary
from farm.api.jobs import JobView as JobView
from farm.api.jobs import PartView as PartView
from farm.api.jobs import PlateStatus as PlateStatus
from farm.api.jobs import RunView as RunView
from farm.api.keys import AppKeyGrant as AppKeyGrant
from farm.api.keys import AppKeyRequestView as AppKeyRequestView
from farm.api.keys import EndedSessions as EndedSessions
from farm.api.keys import KeyRequest as KeyRequest
from farm.api.keys import Keys as Keys
from farm.api.keys import KeyView as KeyView
from farm.api.keys import LoginLink as LoginLink
from farm.api.keys import NetworkView as NetworkView
from farm.api.keys import NewKey as NewKey
from farm.api.prints import FeatureFactorsView as FeatureFactorsView
from farm.api.prints import History as History
from farm.api.prints import HistoryRow as HistoryRow
from farm.api.prints import PrinterSpeed as PrinterSpeed
from farm.api.prints import PrintRow as PrintRow
from farm.api.prints import Prints as Prints
from farm.api.prints import PrintView as PrintView
from farm.api.prints import StillView as StillView
from farm.api.requests import ApproveRequest as ApproveRequest
from farm.api.requests import AssembledRequest as AssembledRequest
from farm.api.requests import ClearedRequest as ClearedRequest
from farm.api.requests import ClearedResponse as ClearedResponse
from farm.api.requests import DownRequest as DownRequest
from farm.api.requests import JobStart as JobStart
from farm.api.requests import LoadRequest as LoadRequest
from farm.api.requests import NameResponse as NameResponse
from farm.api.requests import PruneRequest as PruneRequest
from farm.api.requests import Queue as Queue
from farm.api.requests import QueueEntry as QueueEntry
from farm.api.requests import QueueMove as QueueMove
from farm.api.requests import QueuePlace as QueuePlace
from farm.api.requests import Reason as Reason
from farm.api.status import ClusterTaskView as ClusterTaskView
from farm.api.status import ClusterView as ClusterView
from farm.api.status import ClusterWorkerView as ClusterWorkerView
from farm.api.status import DaemonView as DaemonView
from farm.api.status import FarmOverview as FarmOverview
from farm.api.status import FleetView as FleetView
from farm.api.status import LastPrint as LastPrint
from farm.api.status import NightView as NightView
from farm.api.status import PrinterView as PrinterView
from farm.api.status import PrintProgress as PrintProgress
from farm.api.status import Reel as Reel
from farm.api.status import Status as Status
from farm.api.status import StatusSummary as StatusSummary
from farm.api.status import Targets as Targets
from farm.api.status import Todo as Todo
from farm.api.status import Wait as Wait
from farm.model import JobState


class JobName(View):
    """Number, name, state and part names of a job."""

    id: int
    name: str
    state: JobState
    parts: list[str]


class Names(View):
    """Names of printers, jobs and parts, for shell completion."""

    printers: list[str]
    jobs: list[JobName]


class JobStatus(View):
    """One job, and the daemon."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    daemon: DaemonView
    job: JobView


class SubmitResponse(View):
    """Response to a submission; `again` is true if a job with the same request id already existed."""

    job: int
    again: bool
    # descriptions of options that the farm cannot fulfil, such as more printers than the fleet has
    notices: list[str] = Field(default_factory=list)


class UploadView(View):
    """Progress of a submission that has no response yet."""

    step: str  # description of the step in progress
    received: int  # number of bytes received so far
    size: int  # total number of bytes of the upload


class PrunedJob(View):
    """Job whose files are deleted; its figures and pictures stay."""

    id: int
    name: str
    size_bytes: int  # size of its files; those that other jobs also use are not deleted


class PruneResponse(View):
    """Result of `farm prune`: the jobs and events that it deleted, or would delete in a dry run."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    dry_run: bool
    jobs: list[PrunedJob]  # in the order in which they ended
    freed_bytes: int
    stored_bytes: int  # size of all job files after the deletion
    events: int  # number of deleted entries of the event log


class Problem(View):
    """Response to a request that failed."""

    error: str
    code: str
    exit_code: int


class SlotView(View):
    """Times of a plate on a printer, actual or expected."""

    plate: str
    parts: list[str]
    printer: str
    starts: str
    ends: str
    grams: float
    price: float | None


class Timeline(View):
    """Times and printers of the plates of a planned job."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    job: int
    now: str
    plan: str
    slots: list[SlotView]
    left: list[str]  # names of the plates that no printer can print, because of material, reel or hours
    notices: list[str]  # changes to the model, and options that the farm cannot fulfil
    makespan_s: float
    lower_bound_s: float
    grams: float
    price: float | None
    currency: str | None


class Submission(View):
    """Result for one of several models that one command submitted."""

    model: str
    job: JobView | None = None
    timeline: Timeline | None = None  # timeline of a dry run
    error: str | None = None
    exit_code: int = 0


class Submissions(View):
    """Results for several models that one command submitted."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    submissions: list[Submission]
