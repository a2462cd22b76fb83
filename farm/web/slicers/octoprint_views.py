"""JSON objects that describe the farm as OctoPrint describes its printer. Pure.

The farm is always reported as ready, because it accepts jobs at any time, and because Cura's plugin sends
no files to a printer that is printing. Only the description of a job gives the state of its print.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import farm
from drivers.printers import PROFILES, Profile
from farm import api
from farm.config import PrinterSection
from farm.errors import NotFoundError
from farm.model import Job, PrintState

API_VERSION = "0.1"
SERVER_VERSION = "1.9.0"
"""Version of OctoPrint whose API the farm implements; clients check it."""
READY_TEXT = "Operational"
_STATE_TEXTS = {
    PrintState.ASSIGNED: "Starting",
    PrintState.HEATING: "Starting",
    PrintState.PAUSED: "Paused",
    PrintState.ENDING: "Cancelling",
}
_PRINTING_TEXT = "Printing"
_PROFILE_ID = "_default"
_NUMBER_PATTERN = re.compile(r"[0-9]{1,9}")
_FLAGS = {
    "operational": True,
    "printing": False,
    "cancelling": False,
    "pausing": False,
    "resuming": False,
    "finishing": False,
    "closedOrError": False,
    "error": False,
    "paused": False,
    "ready": True,
    "sdReady": False,
}


def describe_version() -> dict[str, Any]:
    """Describe the version; `text` begins with "OctoPrint", because some clients accept no other server."""
    return {"api": API_VERSION, "server": SERVER_VERSION, "text": f"OctoPrint (farm {farm.__version__})"}


def describe_settings(name: str) -> dict[str, Any]:
    """Describe the settings of a farm or a printer: no SD card, no camera, no plugins."""
    return {
        "appearance": {"name": name, "color": "default"},
        "feature": {"sdSupport": False, "temperatureGraph": False},
        "plugins": {},
        "webcam": {"webcamEnabled": False},
    }


def describe_user(name: str, is_operator: bool) -> dict[str, Any]:
    """Describe a caller."""
    groups = ["admins", "users"] if is_operator else ["users"]
    return {"name": name, "groups": groups, "permissions": []}


def describe_login(name: str, is_operator: bool) -> dict[str, Any]:
    """Describe a caller for the response to a log-in with a key."""
    rights = {"active": True, "admin": is_operator, "user": True}
    return {**describe_user(name, is_operator), **rights, "apikey": None, "settings": {}}


def describe_state(printer: api.PrinterView | None) -> dict[str, Any]:
    """Describe the state of a printer with its temperatures, or of the whole farm if `printer` is None."""
    temperature = {}
    if printer is not None:
        targets = printer.targets
        temperature = {
            "tool0": {"actual": printer.nozzle_c, "target": targets.nozzle_c, "offset": 0},
            "bed": {"actual": printer.bed_c, "target": targets.bed_c, "offset": 0},
        }
    state = {"text": READY_TEXT, "flags": _FLAGS, "error": ""}
    return {"temperature": temperature, "state": state}


def describe_current_job(job: Job | None, progress: api.PrintProgress | None) -> dict[str, Any]:
    """Describe the job that is being printed or is selected.

    Parameters
    ----------
    job
        The job; None if no job is printed or selected.
    progress
        Progress of the job's open print; None if there is none.
    """
    file = dict.fromkeys(("name", "path", "origin", "size", "date"))
    if job is not None:
        file = {**file, **_describe_file_name(job), "date": int(job.submitted_s)}
    elapsed_s = remaining_s = completion = None
    if progress is not None:
        remaining_s, completion = round(progress.remaining_s), progress.progress * 100
        if 0 < progress.progress < 1:
            elapsed_s = round(progress.remaining_s * progress.progress / (1 - progress.progress))
    return {
        "job": {
            "file": file,
            "estimatedPrintTime": None if job is None else job.expected_s,
            "lastPrintTime": None,
            "filament": None,
            "user": None if job is None else job.submitted_by,
        },
        "progress": {
            "completion": completion,
            "filepos": None,
            "printTime": elapsed_s,
            "printTimeLeft": remaining_s,
            "printTimeLeftOrigin": None if remaining_s is None else "estimate",
        },
        "state": READY_TEXT if progress is None else _STATE_TEXTS.get(progress.state, _PRINTING_TEXT),
    }


def describe_file(job: Job, resource: str) -> dict[str, Any]:
    """Describe a job as a file; `resource` is the URL of this description."""
    kind = "model" if job.own_gcode is None else "machinecode"
    return {
        **_describe_file_name(job),
        "type": kind,
        "typePath": [kind, "stl" if job.own_gcode is None else "gcode"],
        "date": int(job.submitted_s),
        "refs": {"resource": resource},
        "gcodeAnalysis": {} if job.expected_s is None else {"estimatedPrintTime": job.expected_s},
    }


def format_file_path(job: Job) -> str:
    """Return the path of a job's file; its folder is the job's number, which makes the path unique."""
    return f"{job.id}/{job.name}"


def _describe_file_name(job: Job) -> dict[str, Any]:
    return {"name": job.name, "display": job.name, "path": format_file_path(job), "origin": "local"}


def find_job(jobs: Mapping[int, Job], path: str, caller_name: str) -> Job:
    """Find the job that a file's path refers to.

    Parameters
    ----------
    jobs
        All jobs by number.
    path
        `NUMBER/NAME`; or only a name: the newest open job with that name, preferably one that the caller
        submitted.
    caller_name
        Name of the caller.

    Raises
    ------
    NotFoundError
        If there is no such job.
    """
    folder, _, name = path.strip("/").rpartition("/")
    if folder:
        numbered_job = jobs.get(int(folder)) if _NUMBER_PATTERN.fullmatch(folder) else None
        found_jobs = [numbered_job] if numbered_job is not None and numbered_job.name == name else []
    else:
        candidates = [job for job in jobs.values() if job.name == name and not job.state.ended]
        found_jobs = [job for job in candidates if job.submitted_by == caller_name] or candidates
    if not found_jobs:
        raise NotFoundError(f"there is no open job for a file {name}: send the file first")
    return max(found_jobs, key=lambda job: job.id)


def describe_profiles(name: str, sections: Iterable[PrinterSection], resource: str) -> dict[str, Any]:
    """Describe the profile of a printer, or of the farm: that of its printer with the lowest build height.

    Parameters
    ----------
    name
        Name of the printer or of the farm.
    sections
        The printers, at least one.
    resource
        URL of the profiles.
    """
    shown_sections = list(sections)
    lowest = min(
        (PROFILES[section.model] for section in shown_sections), key=lambda profile: profile.height_mm
    )
    width_mm, depth_mm = lowest.bed_mm
    profile = {
        "id": _PROFILE_ID,
        "name": name,
        "model": " / ".join(sorted({PROFILES[section.model].title for section in shown_sections})),
        "color": "default",
        "current": True,
        "default": True,
        "resource": f"{resource}/{_PROFILE_ID}",
        "heatedBed": True,
        "heatedChamber": False,
        "volume": {
            "formFactor": "rectangular",
            "origin": "lowerleft",
            "width": width_mm,
            "depth": depth_mm,
            "height": lowest.height_mm,
            "custom_box": False,
        },
        "extruder": {"count": 1, "nozzleDiameter": shown_sections[0].nozzle_mm, "offsets": [[0.0, 0.0]]},
        "axes": _describe_axes(lowest),
    }
    return {"profiles": {_PROFILE_ID: profile}}


def _describe_axes(profile: Profile) -> dict[str, Any]:
    """Describe the maximum feed rate of each axis, in mm/min."""
    speeds = zip("xyze", profile.max_feedrate_mm_s, strict=True)
    return {axis: {"speed": round(speed * 60), "inverted": False} for axis, speed in speeds}


def describe_connection(name: str) -> dict[str, Any]:
    """Describe the connection to the printer, which is always reported as established."""
    return {
        "current": {"state": READY_TEXT, "port": None, "baudrate": None, "printerProfile": _PROFILE_ID},
        "options": {
            "ports": [],
            "baudrates": [],
            "printerProfiles": [{"id": _PROFILE_ID, "name": name}],
            "portPreference": None,
            "baudratePreference": None,
            "printerProfilePreference": _PROFILE_ID,
        },
    }
