"""Facts about an installation: data only."""

from __future__ import annotations

from dataclasses import dataclass

from farm.config import Fleet
from farm.state import Books
from farm.state.retention import DiskUse


@dataclass(frozen=True, slots=True)
class BooksFacts:
    """Database of the books (the farm's state).

    Attributes
    ----------
    path
        Path of the database.
    exists
        True if the database exists.
    schema_version
        Version of its schema; None if it cannot be read.
    books
        The books; None if they cannot be read.
    error
        Reason why the books cannot be read.
    """

    path: str
    exists: bool = True
    schema_version: int | None = None
    books: Books | None = None
    error: str | None = None


@dataclass(frozen=True, slots=True)
class FileFacts:
    """Files of jobs that have not ended.

    Attributes
    ----------
    checked_count
        Number of checked files.
    missing_files, changed_files
        Missing files, and files whose content has changed since planning, each as text with its job.
    """

    checked_count: int = 0
    missing_files: tuple[str, ...] = ()
    changed_files: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AgentFacts:
    """Agent of a printer on this host.

    Attributes
    ----------
    printer
        Its printer.
    is_alive
        True if its process is running.
    protocol
        Version of its protocol; None if it did not answer.
    folder_error
        Reason why its folder cannot be used.
    """

    printer: str
    is_alive: bool
    protocol: int | None = None
    folder_error: str | None = None


@dataclass(frozen=True, slots=True)
class PortFacts:
    """Serial port of a printer on this host.

    Attributes
    ----------
    printer, path
        The printer, and its port in `fleet.yaml`.
    exists, is_usable
        Whether the device exists, and whether this user may read and write it.
    group
        The device's group.
    """

    printer: str
    path: str
    exists: bool
    is_usable: bool = False
    group: str | None = None


@dataclass(frozen=True, slots=True)
class CuraFacts:
    """Path and version of CuraEngine and of Cura's files, or the reasons why they are not found."""

    engine: str | None = None
    engine_version: str | None = None
    engine_error: str | None = None
    resources: str | None = None
    settings_version: str | None = None
    resources_error: str | None = None


@dataclass(frozen=True, slots=True)
class CodeFacts:
    """Compiled machine code of the planning functions (`decompose.jit`).

    Attributes
    ----------
    installed_folder
        Folder of the compiled code beside the sources.
    folder
        Folder of the compiled code that this user's processes use; None if no folder can be written.
    is_compiled
        True if all functions are compiled.
    """

    installed_folder: str
    folder: str | None
    is_compiled: bool


@dataclass(frozen=True, slots=True)
class ClockFacts:
    """Clocks of the host and of the farm.

    Attributes
    ----------
    now_s
        The host's clock, in seconds since the epoch.
    is_synchronised
        True if NTP synchronises it; None if the kernel does not report that.
    scale_and_anchor_s
        Seconds of the farm's clock per wall second, and the time at which both clocks agreed, from the state
        folder; None if the farm has not run yet.
    host_zone
        The host's time zone; None if it has no name.
    """

    now_s: float
    is_synchronised: bool | None = None
    scale_and_anchor_s: tuple[float, float] | None = None
    host_zone: str | None = None


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """Free space on a folder's disk, in bytes; None if the folder is not writable."""

    folder: str
    free_bytes: int | None


@dataclass(frozen=True, slots=True)
class UserFacts:
    """User who runs this program.

    Attributes
    ----------
    name
        The user of this process.
    groups
        The groups of this process.
    existing_groups
        Groups in fleet.yaml that exist on this host.
    state_owner
        Owner of the state folder; None if there is none.
    """

    name: str
    groups: frozenset[str] = frozenset()
    existing_groups: frozenset[str] = frozenset()
    state_owner: str | None = None


@dataclass(frozen=True, slots=True)
class Facts:
    """All facts about an installation, for the checks.

    Attributes
    ----------
    daemon_error
        Reason why the daemon does not answer; None if it does.
    daemon_version, version
        Versions of the daemon and of this program.
    fleet, fleet_error
        The fleet, or the error in its file.
    fleet_path
        Path of the fleet file.
    disk
        Space that the files of jobs take; None if there are no files, or if the books cannot be read.
    """

    version: str
    fleet_path: str
    books: BooksFacts
    cura: CuraFacts
    clock: ClockFacts
    user: UserFacts
    daemon_error: str | None = None
    daemon_version: str | None = None
    fleet: Fleet | None = None
    fleet_error: str | None = None
    files: FileFacts = FileFacts()
    agents: tuple[AgentFacts, ...] = ()
    ports: tuple[PortFacts, ...] = ()
    free_spaces: tuple[FreeSpace, ...] = ()
    disk: DiskUse | None = None
    code: CodeFacts | None = None
    shared_memory: FreeSpace = FreeSpace("/dev/shm", None)
