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

    part: str  # part that was printed; a piece also lists prints of the part from which it was cut
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
    """A print that has ended."""

    job: int
    name: str  # the job's
    note: str | None  # the job's
    submitted_by: str | None
    took_s: float
    expected_s: float
    grams: float
    wasted: bool
    assembled: str | None = None  # when a person reported that the job's parts are glued
    assembly_s: float | None = None  # the time that the gluing took


class FeatureFactorsView(View):
    """Actual over sliced time of the layers by what they print, learned from finished prints."""

    walls: float
    infill: float
    skins: float
    supports: float  # the brim too
    travel: float  # retractions too
    prints: int  # number of prints from which they were learned
    own: bool  # of this printer alone; else of all printers of its family


class PrinterSpeed(View):
    """Speed of a printer, learned from its finished prints."""

    printer: str
    time_factor: float  # actual over expected time of its layers
    feature_factors: FeatureFactorsView | None  # null until enough prints have ended


class History(View):
    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    prints: list[HistoryRow]  # oldest first
    speeds: list[PrinterSpeed] = Field(default_factory=list)  # of the printers of these prints


class PrintRow(HistoryRow):
    """A print, open or ended; `took_s` of an open print is the time so far."""

    id: str
    plate: str


class Prints(View):
    """Prints in the order in which they were started."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    prints: list[PrintRow]
