"""Checks of the facts about an installation. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import UTC, datetime

from drivers.messages import PROTOCOL
from farm.doctor.facts import Facts
from farm.doctor.finding import Finding, make_problem, make_success, make_warning
from farm.planning.job_planner import MIN_FREE_BYTES
from farm.state import validate_books
from farm.state.retention import describe_shortage
from farm.state.storage import SCHEMA_VERSION
from farm.text import format_count

RECOMMENDED_FREE_BYTES = 2 * 1024**3
"""Free bytes that suffice for the plans, slices and backups of a large job."""
MIN_SHARED_MEMORY_BYTES = 16 * 1024**2
_MIN_PLAUSIBLE_YEAR = 2024  # a host without a real-time clock starts in 1970
_MAX_SHOWN_PROBLEMS = 5


def check_installation(facts: Facts) -> list[Finding]:
    """Check an installation by its facts.

    Returns
    -------
    list of Finding
        Findings in the order in which to fix them, at least one for each check.
    """
    return [finding for check in _CHECKS for finding in check(facts)]


def check_fleet(facts: Facts) -> Iterator[Finding]:
    """Check that `fleet.yaml` can be read and lists printers."""
    if facts.fleet is None:
        error = facts.fleet_error or f"{facts.fleet_path} cannot be read"
        text, _, action = error.partition("; ")  # some errors end with the action
        yield make_problem("fleet", text, action or "correct the fleet file")
    elif not facts.fleet.printers:
        yield make_problem(
            "fleet",
            f"{facts.fleet_path} has no printers",
            "`farm discover` prints an entry for each connected printer",
        )
    else:
        enabled_count = sum(section.enabled for section in facts.fleet.printers)
        yield make_success(
            "fleet",
            f"{facts.fleet_path}: {format_count(len(facts.fleet.printers), 'printer')}, "
            f"{enabled_count} in use",
        )


def check_daemon(facts: Facts) -> Iterator[Finding]:
    """Check that the daemon answers, and that its version is the version of this program."""
    if facts.daemon_error is not None:
        yield make_warning("daemon", facts.daemon_error, "running agents continue printing without it")
    elif facts.daemon_version != facts.version:
        text = f"the daemon is farm {facts.daemon_version}, but this program is {facts.version}"
        yield make_warning("daemon", text, "`farm down`, then `farm up`; prints continue in the meantime")
    else:
        yield make_success("daemon", f"the daemon is up, farm {facts.version}")


def check_user(facts: Facts) -> Iterator[Finding]:
    """Check that this user owns the state folder, and that the groups of the farm exist."""
    user = facts.user
    if user.state_owner is not None and user.state_owner != user.name:
        text = f"the state folder belongs to {user.state_owner}, not {user.name}: some checks need its owner"
        yield make_warning("user", text, f"`sudo -u {user.state_owner} farm doctor`")
    else:
        yield make_success("user", f"the farm belongs to {user.name}")
    if facts.fleet is None:
        return
    operators = facts.fleet.fleet.operators
    if operators is not None and operators not in user.existing_groups:
        yield make_problem(
            "groups", f"fleet.operators: there is no group {operators}", f"`sudo groupadd {operators}`"
        )
    elif operators is not None and operators not in user.groups:
        text = f"{user.name} is not in the group {operators}: only its members may approve, clear and resume"
        yield make_warning("groups", text, f"`sudo usermod -aG {operators} {user.name}`, then log in again")
    else:
        group = facts.fleet.fleet.group
        users = (
            f"members of {group}"
            if group in user.existing_groups
            else f"{user.name} alone, as there is no group {group}"
        )
        yield make_success("groups", f"the daemon's socket is open to {users}")


def check_books(facts: Facts) -> Iterator[Finding]:
    """Check that the books can be read and are consistent."""
    books = facts.books
    if not books.exists:
        yield make_success("database", f"there is no database at {books.path} yet: `farm up` creates one")
        return
    if books.books is None:
        action = "see docs/how-to/backup-restore.md: the daemon restores the newest intact backup"
        yield make_problem("database", books.error or f"{books.path} cannot be read", action)
        return
    problems = validate_books(books.books)
    action = "report this with the database; `farm history` shows what was printed"
    yield from (make_problem("database", text, action) for text in problems[:_MAX_SHOWN_PROBLEMS])
    if len(problems) > _MAX_SHOWN_PROBLEMS:
        yield make_problem(
            "database", f"and {len(problems) - _MAX_SHOWN_PROBLEMS} more contradictions", action
        )
    if not problems:
        jobs, prints = (
            format_count(len(books.books.jobs), "job"),
            format_count(len(books.books.prints), "print"),
        )
        schema = f"schema {books.schema_version}" + (
            "" if books.schema_version == SCHEMA_VERSION else f" (the daemon migrates it to {SCHEMA_VERSION})"
        )
        yield make_success("database", f"{books.path}: {schema}, {jobs} and {prints}, consistent")


def check_files(facts: Facts) -> Iterator[Finding]:
    """Check that the files of unfinished jobs exist and match their plans."""
    files = facts.files
    action = "`farm cancel` the job, and submit its model again"
    for condition, names in (
        ("is missing", files.missing_files),
        ("has changed since it was planned", files.changed_files),
    ):
        yield from (
            make_problem("files", f"{name} {condition}", action) for name in names[:_MAX_SHOWN_PROBLEMS]
        )
        if len(names) > _MAX_SHOWN_PROBLEMS:
            yield make_problem(
                "files", f"and {len(names) - _MAX_SHOWN_PROBLEMS} more: each {condition}", action
            )
    if not files.missing_files and not files.changed_files:
        count = format_count(files.checked_count, "file")
        yield make_success("files", f"{count} of unfinished jobs, as planned")


def check_agents(facts: Facts) -> Iterator[Finding]:
    """Check that agents are running while the daemon is up, and that they use the current protocol."""
    for agent in facts.agents:
        name = agent.printer
        if agent.folder_error is not None:
            action = "change its owner to the user of the farm (`chown`), and check the disk"
            yield make_problem(
                "agents", f"{name}: its agent's folder cannot be used: {agent.folder_error}", action
            )
        elif not agent.is_alive and facts.daemon_error is None:
            text = f"{name}: its agent is not running, though the daemon is up"
            yield make_problem("agents", text, f"read the end of agents/{name}/agent.log in the state folder")
        elif not agent.is_alive:
            yield make_success("agents", f"{name}: no agent, because the daemon is down")
        elif agent.protocol is None:
            text = f"{name}: its agent is running but does not answer"
            yield make_problem("agents", text, f"`farm up --replace {name}` when nothing is printing there")
        elif agent.protocol < PROTOCOL:
            text = f"{name}: its agent has an earlier version (protocol {agent.protocol}, not {PROTOCOL})"
            yield make_warning("agents", text, f"`farm up --replace {name}` when nothing is printing there")
        else:
            yield make_success("agents", f"{name}: its agent answers")


def check_ports(facts: Facts) -> Iterator[Finding]:
    """Check that the serial ports exist, and that this user has access to them."""
    for port in facts.ports:
        port_name = f"{port.printer}: {port.path}"
        if not port.exists:
            action = "switch the printer on and plug it in; `farm discover` lists the existing ports"
            yield make_problem("ports", f"{port_name} does not exist", action)
        elif not port.is_usable:
            group = port.group or "dialout"
            action = f"`sudo usermod -aG {group} {facts.user.name}`, then log in again"
            if group in facts.user.groups:
                action = "check the permissions of the device (`ls -l`), and see deploy/udev"
            yield make_problem("ports", f"{facts.user.name} may not read and write {port_name}", action)
        else:
            yield make_success("ports", f"{port_name} exists and can be used")


def check_cura(facts: Facts) -> Iterator[Finding]:
    """Check that CuraEngine and Cura's files exist, and report their versions."""
    cura, action = facts.cura, "`farm setup` installs both"
    if cura.engine is None:
        yield _describe_missing_file(cura.engine_error or f"there is no CuraEngine: {action}")
    elif cura.engine_version is None:
        yield make_problem("cura", f"{cura.engine} does not report its version: it cannot be run", action)
    else:
        yield make_success("cura", f"{cura.engine}: CuraEngine {cura.engine_version}")
    if cura.resources is None:
        yield _describe_missing_file(cura.resources_error or f"Cura's files are missing: {action}")
    elif cura.settings_version is None:
        yield make_problem("cura", f"{cura.resources}: its definitions do not state a version", action)
    else:
        yield make_success("cura", f"{cura.resources}: Cura's settings, version {cura.settings_version}")


def _describe_missing_file(error: str) -> Finding:
    """Return a finding about a missing file; the part of the error after the last colon is the action."""
    text, _, action = error.rpartition(": ")
    return make_problem("cura", text, action)


def check_clock(facts: Facts) -> Iterator[Finding]:
    """Check that the host's clock is set and synchronised, and that the farm's clock matches it."""
    clock = facts.clock
    now = datetime.fromtimestamp(clock.now_s, UTC)
    action = "`sudo timedatectl set-ntp true`; attended and quiet hours follow this clock"
    if now.year < _MIN_PLAUSIBLE_YEAR:
        yield make_problem("clock", f"the host's clock shows {now:%Y-%m-%d}: it is not set", action)
    elif clock.is_synchronised is False:
        yield make_warning(
            "clock", "the host's clock is not synchronised (no NTP): its time may jump", action
        )
    else:
        yield make_success("clock", f"the host's clock shows {now:%Y-%m-%d %H:%M} UTC")
    if facts.fleet is None:
        return
    scale, zone = facts.fleet.fleet.time_scale, facts.fleet.fleet.timezone
    if clock.scale_and_anchor_s is not None and clock.scale_and_anchor_s[0] != scale:
        old_scale = clock.scale_and_anchor_s[0]
        text = f"the state folder was used with time_scale {old_scale:g}, but fleet.yaml says {scale:g}"
        yield make_problem(
            "clock", text, "restore that value in fleet.yaml, or name another folder with --state"
        )
    elif clock.scale_and_anchor_s is not None and clock.scale_and_anchor_s[1] > clock.now_s:
        text = "the start of the farm's clock is in the future: the host's clock was set back"
        yield make_warning("clock", text, action)
    if clock.host_zone is not None and clock.host_zone != zone:
        text = f"hours in fleet.yaml are in {zone}, but the host is in {clock.host_zone}"
        yield make_warning("clock", text, "if that is wrong, set fleet.timezone to the printers' time zone")


def check_free_space(facts: Facts) -> Iterator[Finding]:
    """Check the free space on the disks and in shared memory."""
    for space in facts.free_spaces:
        if space.free_bytes is None:
            yield make_problem("room", f"{space.folder} cannot be written", "check its owner and its disk")
            continue
        text = f"{space.folder} has {space.free_bytes / 1024**2:.0f} MB free"
        if space.free_bytes < MIN_FREE_BYTES:
            yield make_problem(
                "room", f"{text}: too little to plan, or to write the database", "free some space"
            )
        elif space.free_bytes < RECOMMENDED_FREE_BYTES:
            yield make_warning("room", f"{text}: a large job may not fit", "free some space")
        else:
            yield make_success("room", text)
    if facts.disk is not None and facts.fleet is not None and facts.free_spaces:
        rules = facts.fleet.fleet
        folder = facts.free_spaces[0].folder
        shortage = describe_shortage(folder, facts.disk, rules.keep.gb, rules.uploads.free_gb)
        if shortage is not None:
            text, _, action = shortage.partition(": ")
            yield make_warning("room", text, action)
    memory = facts.shared_memory
    if memory.free_bytes is None or memory.free_bytes < MIN_SHARED_MEMORY_BYTES:
        text = f"{memory.folder} cannot be used, or is full: some steps of planning use only one core"
        yield make_warning(
            "room", text, "mount it (in a container: `--shm-size=256m`), or delete files there"
        )
    else:
        yield make_success("room", f"{memory.folder} can be used")


def check_code(facts: Facts) -> Iterator[Finding]:
    """Check that the planning code is compiled, and that its cache can be written."""
    code = facts.code
    if code is None:
        return
    if code.folder is None:
        text = f"neither {code.installed_folder} nor {facts.user.name}'s cache can be written"
        yield make_warning("code", f"{text}: each worker spends minutes compiling", "make ~/.cache writable")
    elif not code.is_compiled:
        yield make_warning(
            "code", "the planning code is not compiled: the first plan takes minutes", "`farm setup`"
        )
    else:
        copy_note = "" if code.folder == code.installed_folder else f", a copy of {code.installed_folder}"
        yield make_success("code", f"the planning code is compiled in {code.folder}{copy_note}")


_CHECKS: tuple[Callable[[Facts], Iterator[Finding]], ...] = (
    check_fleet,
    check_user,
    check_daemon,
    check_books,
    check_files,
    check_agents,
    check_ports,
    check_cura,
    check_code,
    check_clock,
    check_free_space,
)
