"""Collection of facts about an installation: files, processes, devices, clocks. Nothing is changed."""

from __future__ import annotations

import asyncio
import ctypes
import getpass
import grp
import os
import pwd
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import farm
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.printers import PROFILES
from drivers.remote import AgentClient, is_alive
from farm.config import Fleet, PrinterSection
from farm.doctor.facts import (
    AgentFacts,
    BooksFacts,
    ClockFacts,
    CodeFacts,
    CuraFacts,
    Facts,
    FileFacts,
    FreeSpace,
    PortFacts,
    UserFacts,
)
from farm.errors import FarmError
from farm.fleet_file import load_fleet
from farm.model import Job
from farm.paths import FarmPaths, StateFolder, read_anchor
from farm.planning.inspection import complete_section
from farm.state import Books
from farm.state.retention import DiskUse
from farm.state.storage import compute_sha256, read_books
from farm.upkeep.disk_use import measure_disk
from slicing.errors import SlicingError
from slicing.settings import find_engine, find_resources

_AGENT_TIMEOUT_S = 10.0
_ENGINE_TIMEOUT_S = 20.0
_TIME_ERROR = 5  # result of adjtimex(2) if the clock is not synchronised
_ENGINE_VERSION_PATTERN = re.compile(r"version (\d+(?:\.\d+)+)")
_SETTINGS_VERSION_PATTERN = re.compile(r'"setting_version":\s*(\d+)')
_SHARED_MEMORY_FOLDER = Path("/dev/shm")


def collect_facts(paths: FarmPaths, daemon_version: str | None, daemon_error: str | None) -> Facts:
    """Collect the facts about an installation.

    Parameters
    ----------
    paths
        State folder, socket and fleet file.
    daemon_version, daemon_error
        The daemon's version, or the reason why the daemon did not answer.
    """
    fleet, fleet_error = _read_fleet(paths.fleet)
    books = _read_books(paths.state)
    local_printers = [s for s in fleet.printers if s.enabled and s.host is None] if fleet is not None else []
    return Facts(
        version=farm.__version__,
        fleet_path=str(paths.fleet),
        books=books,
        cura=_read_cura_facts(),
        clock=_read_clock_facts(paths.state),
        user=_read_user_facts(fleet, paths.state),
        daemon_error=daemon_error,
        daemon_version=daemon_version,
        fleet=fleet,
        fleet_error=fleet_error,
        files=_collect_file_facts(books.books, paths.state) if books.books is not None else FileFacts(),
        agents=tuple(
            _query_agent_facts(section.name, paths.state.find_agent_folder(section.name))
            for section in local_printers
        ),
        ports=tuple(
            _collect_port_facts(section) for section in local_printers if section.port.startswith("/")
        ),
        disk=_measure_disk(paths.state, books.books),
        free_spaces=tuple(_measure_free_spaces(paths.state)),
        code=_read_code_facts(),
        shared_memory=_measure_free_space(_SHARED_MEMORY_FOLDER),
    )


def _read_fleet(path: Path) -> tuple[Fleet | None, str | None]:
    try:
        return load_fleet(path, frozenset(PROFILES), complete_section), None
    except FarmError as error:
        return None, str(error)


def _read_books(state: StateFolder) -> BooksFacts:
    path = str(state.books)
    try:
        if not state.books.exists():
            return BooksFacts(path, exists=False)
        books, schema_version = read_books(state.books)
    except (FarmError, OSError) as error:
        return BooksFacts(path, error=str(error))
    return BooksFacts(path, schema_version=schema_version, books=books)


def _collect_file_facts(books: Books, state: StateFolder) -> FileFacts:
    count, missing_files, changed_files = 0, [], []
    for job in books.jobs.values():
        if job.state.ended:
            continue
        for name, sha256 in _list_job_files(books, job):
            count += 1
            path = state.files / name
            try:
                if compute_sha256(path) != sha256:
                    changed_files.append(f"job {job.id}: {path}")
            except OSError:
                missing_files.append(f"job {job.id}: {path}")
    return FileFacts(count, tuple(missing_files), tuple(changed_files))


def _list_job_files(books: Books, job: Job) -> Iterator[tuple[str, str]]:
    """Yield the name and the SHA-256 of each file of a job; a file in the store is named by its hash."""
    yield job.model_file, Path(job.model_file).stem
    for plate in books.list_plates(job):
        yield plate.gcode, plate.sha256
        yield from ((books.parts[name].file, Path(books.parts[name].file).stem) for name in plate.parts)


def _query_agent_facts(printer: str, folder: Path) -> AgentFacts:
    try:
        if folder.exists() and not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            return AgentFacts(printer, is_alive=False, folder_error=f"{folder} is not accessible to you")
        if not is_alive(folder):
            return AgentFacts(printer, is_alive=False)
    except OSError as error:
        return AgentFacts(printer, is_alive=False, folder_error=str(error))
    return AgentFacts(printer, is_alive=True, protocol=asyncio.run(_query_protocol(folder)))


async def _query_protocol(folder: Path) -> int | None:
    client = AgentClient(folder)
    try:
        async with asyncio.timeout(_AGENT_TIMEOUT_S):
            await client.connect()
            async for snapshot in client.receive_snapshots():
                return snapshot.protocol
    except (DriverError, OSError, TimeoutError):
        return None
    finally:
        await client.close()
    return None


def _collect_port_facts(section: PrinterSection) -> PortFacts:
    path = Path(section.port)
    try:
        status = path.stat()
    except OSError:
        return PortFacts(section.name, section.port, exists=False)
    group = None
    with suppress(KeyError):
        group = grp.getgrgid(status.st_gid).gr_name
    is_usable = os.access(path, os.R_OK | os.W_OK)
    return PortFacts(section.name, section.port, exists=True, is_usable=is_usable, group=group)


def _read_cura_facts() -> CuraFacts:
    engine = engine_version = engine_error = resources = settings_version = resources_error = None
    try:
        engine_path = find_engine()
        engine, engine_version = str(engine_path), _read_engine_version(engine_path)
    except SlicingError as error:
        engine_error = str(error)
    try:
        folder = find_resources().root
        resources, settings_version = str(folder), _read_settings_version(folder)
    except SlicingError as error:
        resources_error = str(error)
    return CuraFacts(engine, engine_version, engine_error, resources, settings_version, resources_error)


def _read_engine_version(engine: Path) -> str | None:
    """Return the version in the help text of CuraEngine, which exits with code 1."""
    try:
        result = subprocess.run(
            [engine, "help"], capture_output=True, text=True, timeout=_ENGINE_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    match = _ENGINE_VERSION_PATTERN.search(result.stdout + result.stderr)
    return match.group(1) if match else None


def _read_settings_version(resources: Path) -> str | None:
    try:
        text = (resources / "definitions" / "fdmprinter.def.json").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    match = _SETTINGS_VERSION_PATTERN.search(text)
    return match.group(1) if match else None


def _read_code_facts() -> CodeFacts:
    from decompose.jit import CODE_FOLDER, INSTALLED_FOLDER, is_compiled  # slow to load

    return CodeFacts(str(INSTALLED_FOLDER), None if CODE_FOLDER is None else str(CODE_FOLDER), is_compiled())


def _read_clock_facts(state: StateFolder) -> ClockFacts:
    return ClockFacts(
        now_s=time.time(),
        is_synchronised=_is_clock_synchronised(),
        scale_and_anchor_s=read_anchor(state.clock),
        host_zone=_read_host_zone(),
    )


def _is_clock_synchronised() -> bool | None:
    """Return whether NTP synchronises the kernel's clock; None if the kernel does not report that."""
    # A buffer larger than struct timex. Its first word is the mode: 0 only reads the state.
    timex = ctypes.create_string_buffer(512)
    try:
        answer = ctypes.CDLL(None, use_errno=True).adjtimex(timex)
    except (OSError, AttributeError):
        return None
    return None if answer < 0 else bool(answer != _TIME_ERROR)


def _read_host_zone() -> str | None:
    with suppress(OSError):
        target = str(Path("/etc/localtime").resolve(strict=True))
        if "/zoneinfo/" in target:
            return target.partition("/zoneinfo/")[2]
    return None


def _read_user_facts(fleet: Fleet | None, state: StateFolder) -> UserFacts:
    groups = set()
    for gid in {*os.getgroups(), os.getgid()}:
        with suppress(KeyError):
            groups.add(grp.getgrgid(gid).gr_name)
    existing_groups = set()
    for name in {fleet.fleet.group, fleet.fleet.operators} if fleet is not None else ():
        with suppress(KeyError):
            existing_groups.add(grp.getgrnam(name or "").gr_name)
    owner = None
    with suppress(OSError, KeyError):
        owner = pwd.getpwuid(state.root.stat().st_uid).pw_name
    return UserFacts(getpass.getuser(), frozenset(groups), frozenset(existing_groups), owner)


def _measure_free_spaces(state: StateFolder) -> Iterator[FreeSpace]:
    folder = state.root
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent  # `farm up` creates it there
    for path in dict.fromkeys((folder, Path(tempfile.gettempdir()))):
        yield _measure_free_space(path)


def _measure_disk(state: StateFolder, books: Books | None) -> DiskUse | None:
    if books is None or not state.files.is_dir():
        return None
    clock = Clock(*(read_anchor(state.clock) or ()))
    with suppress(OSError):
        return measure_disk(state, books, clock.now(), clock.scale)
    return None


def _measure_free_space(folder: Path) -> FreeSpace:
    try:
        is_usable = os.access(folder, os.W_OK | os.X_OK)
        return FreeSpace(str(folder), shutil.disk_usage(folder).free if is_usable else None)
    except OSError:
        return FreeSpace(str(folder), None)
