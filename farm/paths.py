"""Paths of a farm: state folder, socket, fleet file."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from farm.errors import FarmError, RefusedError

SHARED_SOCKET = Path("/run/farm/farm.sock")
"""Socket of the farm that all users of a host share (`deploy/systemd`)."""
_MAX_SOCKET_PATH_BYTES = 100  # sun_path holds 108 bytes


@dataclass(frozen=True, slots=True)
class StateFolder:
    """State folder of a farm: the daemon's files, and a folder for each agent."""

    root: Path

    @property
    def books(self) -> Path:
        """Database with the farm's state (the books)."""
        return self.root / "farm.db"

    @property
    def backups(self) -> Path:
        """Nightly copies of the database."""
        return self.root / "backups"

    @property
    def files(self) -> Path:
        """File store, in which files are named by their hashes."""
        return self.root / "files"

    @property
    def work(self) -> Path:
        """Folder for temporary files of planning and uploads; emptied when the daemon starts."""
        return self.root / "work"

    @property
    def slices(self) -> Path:
        """Slice cache."""
        return self.root / "slices"

    @property
    def jobs(self) -> Path:
        """Folder with a folder for each job."""
        return self.root / "jobs"

    def find_job_folder(self, number: int) -> Path:
        """Return the folder in which the files of a job have readable names, for people."""
        return self.jobs / str(number)

    @property
    def lock(self) -> Path:
        """File that a running daemon locks; it contains the daemon's process id."""
        return self.root / "lock"

    @property
    def log(self) -> Path:
        return self.root / "daemon.log"

    @property
    def clock(self) -> Path:
        """File with the scale and the anchor of the farm's clock."""
        return self.root / "clock.json"

    @property
    def notices(self) -> Path:
        """File with the ids of the notices that were sent."""
        return self.root / "told.json"

    def find_agent_folder(self, printer: str) -> Path:
        """Return the folder of a printer's agent."""
        return self.root / "agents" / printer

    def make(self) -> None:
        """Create missing folders. Raises FarmError if that fails."""
        try:
            self.root.mkdir(mode=0o700, parents=True, exist_ok=True)
            for folder in (self.files, self.work, self.slices, self.root / "agents"):
                folder.mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            raise FarmError(
                f"the state folder {self.root} cannot be used ({error}); give another with --state"
            ) from error


@dataclass(frozen=True, slots=True)
class FarmPaths:
    """Paths from the options `--state`, `--socket` and `--fleet`, which nearly every command has."""

    state: StateFolder
    socket: Path
    fleet: Path
    url: str | None = None  # URL of a daemon on another host; used instead of the socket
    key_file: Path | None = None  # file with the key for the URL


def find_farm_paths(
    state: Path | None,
    socket: Path | None,
    fleet: Path | None,
    env: Mapping[str, str] = os.environ,
    shared_socket: Path = SHARED_SOCKET,
) -> FarmPaths:
    """Find the paths of a farm from the options, then from the environment, then from the XDG folders.

    If a state folder is named but no socket, the socket is in that folder, so that two farms on one host
    never share a socket. If neither is named, and this user has no daemon, `shared_socket` is used.

    Parameters
    ----------
    state, socket, fleet
        Paths that were named by options.
    env
        The environment.
    shared_socket
        Socket of the farm that all users share.

    Raises
    ------
    RefusedError
        If the socket must be in the system's temporary folder, and another user could replace it there.
    """
    home = Path(env.get("HOME", "/"))
    state_path = state or _read_path(env, "FARM_STATE")
    root = (state_path or (_read_path(env, "XDG_STATE_HOME") or home / ".local/state") / "farm").absolute()
    socket = socket or _read_path(env, "FARM_SOCKET")
    if socket is None:
        runtime = _read_path(env, "XDG_RUNTIME_DIR")
        socket = runtime / "farm" / "farm.sock" if runtime and state_path is None else root / "farm.sock"
        if state_path is None and not _check_path(socket.exists) and _check_path(shared_socket.parent.is_dir):
            socket = shared_socket
    fleet = fleet or _read_path(env, "FARM_FLEET")
    if fleet is None:
        config = (_read_path(env, "XDG_CONFIG_HOME") or home / ".config") / "farm" / "fleet.yaml"
        candidates = (Path("fleet.yaml"), config, Path("/etc/farm/fleet.yaml"))
        fleet = next((path for path in candidates if _check_path(path.is_file)), candidates[0])
    return FarmPaths(StateFolder(root), _shorten_socket_path(socket.absolute(), env), fleet.absolute())


def _check_path(check: Callable[[], bool]) -> bool:
    """Check a path; return False if its folder is inaccessible, such as after `su`."""
    try:
        return check()
    except OSError:
        return False


def _read_path(env: Mapping[str, str], name: str) -> Path | None:
    return Path(env[name]) if env.get(name) else None


def _shorten_socket_path(socket: Path, env: Mapping[str, str]) -> Path:
    """Replace a path that is too long for a socket with a short path that depends only on the long path."""
    if len(os.fsencode(socket)) <= _MAX_SOCKET_PATH_BYTES:
        return socket
    digest = hashlib.sha256(os.fsencode(socket)).hexdigest()[:16]
    folder = _read_path(env, "XDG_RUNTIME_DIR") or _make_private_folder(f"farm-{os.getuid()}")
    return folder / f"farm-{digest}.sock"


def _make_private_folder(name: str) -> Path:
    """Create a private folder, which other users cannot replace, in the system's temporary folder.

    Raises
    ------
    RefusedError
        If the folder exists and belongs to another user, or others can write to it.
    """
    folder = Path(tempfile.gettempdir()) / name
    advice = "remove it, or name a shorter --socket"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise RefusedError(f"{folder} cannot be used for the farm's socket ({error}): {advice}") from error
    if not stat.S_ISDIR(status.st_mode):
        raise RefusedError(
            f"{folder} is not a folder, so the farm's socket cannot be trusted there: {advice}"
        )
    if status.st_uid != os.getuid():
        raise RefusedError(f"{folder} belongs to another user, who could answer for the farm: {advice}")
    if status.st_mode & 0o077:
        raise RefusedError(f"{folder} is open to other users (mode {status.st_mode & 0o777:o}): {advice}")
    return folder


def read_anchor(path: Path) -> tuple[float, float] | None:
    """Read the scale and the anchor of the farm's clock (see `Clock`); None if there is no valid file."""
    try:
        anchor = json.loads(path.read_text())
        return float(anchor["scale"]), float(anchor["anchor_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_anchor(path: Path, scale: float, anchor_s: float) -> None:
    """Write the scale and the anchor of the farm's clock atomically."""
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps({"scale": scale, "anchor_s": anchor_s}))
    temporary.replace(path)
