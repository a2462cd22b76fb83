"""Prints, open and ended."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from farm.api.base import SCHEMA, View
from farm.model import Moment, PrintState, Verdict


class StillView(View):
    """Picture of a print by its printer's camera."""

    moment: Moment
    taken: str
    file: str | None  # null if the files of its job were pruned


class PrintView(View):
    """One attempt to print the plate of a part."""

    part: str  # part that was printed: the part itself, or the part from which it was cut
    printer: str
    state: PrintState
    fault: str | None
    reason: str | None
    verdict: Verdict | None
    why: str | None  # reason for the verdict
    started: str | None
    ended: str | None
    stills: list[StillView] = Field(default_factory=list)


class HistoryRow(PrintView):
    """Print that has ended."""

    job: int
    name: str  # name of the job
    note: str | None  # note of the job
    submitted_by: str | None
    took_s: float
    expected_s: float
    grams: float
    wasted: bool
    assembled: str | None = None  # time at which a person reported that the job's parts are glued
    assembly_s: float | None = None  # time that the gluing took


class FeatureFactorsView(View):
    """Ratios of the actual to the sliced time by feature, learned from finished prints."""

    walls: float
    infill: float
    skins: float
    supports: float  # includes the brim
    travel: float  # includes retractions
    prints: int  # number of prints from which they were learned
    own: bool  # whether they were learned from this printer alone; otherwise from all printers of its family


class PrinterSpeed(View):
    """Speed of a printer, learned from its finished prints."""

    printer: str
    time_factor: float  # ratio of the actual to the sliced time of its layers
    feature_factors: FeatureFactorsView | None  # null until enough prints have ended


class History(View):
    """Response to `farm history --json`."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    prints: list[HistoryRow]  # oldest first
    speeds: list[PrinterSpeed] = Field(default_factory=list)  # speeds of the printers of these prints


class PrintRow(HistoryRow):
    """Print, open or ended; `took_s` of an open print is the time so far."""

    id: str
    plate: str


class Prints(View):
    """Prints in the order in which they were started."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    prints: list[PrintRow]
