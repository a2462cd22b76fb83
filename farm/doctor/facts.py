"""Facts about an installation, as they were found. Data alone."""

from __future__ import annotations

from dataclasses import dataclass

from farm.config import Fleet
from farm.state import Books


@dataclass(frozen=True, slots=True)
class BooksFacts:
    """The books on the disk.

    Attributes
    ----------
    path
        Where they are.
    exists
        Whether there is such a file.
    form
        The version of their form; None where it cannot be read.
    books
        Their entries; None where they cannot be read.
    error
        Why they cannot be read.
    """

    path: str
    exists: bool = True
    form: int | None = None
    books: Books | None = None
    error: str | None = None


@dataclass(frozen=True, slots=True)
class FileFacts:
    """The files of jobs that have not ended.

    Attributes
    ----------
    checked
        How many files were looked at.
    missing, changed
        Files that are gone, and files with other content than planned: who needs them, and their names.
    """

    checked: int = 0
    missing: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AgentFacts:
    """The agent of a printer of this host.

    Attributes
    ----------
    printer
        Its printer.
    alive
        Whether its process lives.
    protocol
        What it speaks; None where it did not answer.
    folder_error
        Why its folder cannot be used.
    """

    printer: str
    alive: bool
    protocol: int | None = None
    folder_error: str | None = None


@dataclass(frozen=True, slots=True)
class PortFacts:
    """The serial port of a printer of this host.

    Attributes
    ----------
    printer, path
        The printer, and its port as `fleet.yaml` has it.
    exists, usable
        Whether there is such a device, and whether this user may read and write it.
    group
        The device's group.
    """

    printer: str
    path: str
    exists: bool
    usable: bool = False
    group: str | None = None


@dataclass(frozen=True, slots=True)
class CuraFacts:
    """CuraEngine and Cura's files; each is named, with its version, or the reason why it is not found."""

    engine: str | None = None
    engine_version: str | None = None
    engine_error: str | None = None
    resources: str | None = None
    settings_version: str | None = None
    resources_error: str | None = None


@dataclass(frozen=True, slots=True)
class ClockFacts:
    """The clocks.

    Attributes
    ----------
    now_s
        The host's, in seconds since the epoch.
    synchronised
        Whether the kernel says that NTP keeps it; None where it cannot tell.
    anchor
        Scale and anchor of the farm's clock in the state folder; None where there is none yet.
    host_zone
        The host's time zone; None where it has no name.
    """

    now_s: float
    synchronised: bool | None = None
    anchor: tuple[float, float] | None = None
    host_zone: str | None = None


@dataclass(frozen=True, slots=True)
class RoomFacts:
    """Free room of a folder's disk, in bytes; None where it cannot be written."""

    folder: str
    free_bytes: int | None


@dataclass(frozen=True, slots=True)
class UserFacts:
    """Who runs the farm.

    Attributes
    ----------
    name
        The user of this process.
    groups
        The groups of this process.
    known_groups
        Those of the groups that matter which the host has.
    state_owner
        Whose the state folder is; None where there is none.
    """

    name: str
    groups: frozenset[str] = frozenset()
    known_groups: frozenset[str] = frozenset()
    state_owner: str | None = None


@dataclass(frozen=True, slots=True)
class Facts:
    """All that the checks look at.

    Attributes
    ----------
    daemon_error
        Why the daemon does not answer; None where it does.
    daemon_version, version
        The daemon's version, and this program's.
    fleet, fleet_error
        The fleet, or what is wrong with its file.
    fleet_path
        Where that file is.
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
    rooms: tuple[RoomFacts, ...] = ()
    shared_memory: RoomFacts = RoomFacts("/dev/shm", None)
