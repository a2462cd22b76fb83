"""Paths of a farm: state folder, socket, fleet file."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from farm.errors import FarmError, Refused

SHARED_SOCKET = Path("/run/farm/farm.sock")
"""Of the farm that all users of a host share (`deploy/systemd`)."""
_LONGEST_SOCKET_PATH = 100  # bytes; sun_path holds 108, and uvicorn knows no way round


@dataclass(frozen=True, slots=True)
class StateFolder:
    """The daemon's folder. Each agent has one of its own below it."""

    root: Path

    @property
    def books(self) -> Path:
        return self.root / "farm.db"

    @property
    def backups(self) -> Path:
        """Copies of the books, one a night."""
        return self.root / "backups"

    @property
    def files(self) -> Path:
        return self.root / "files"

    @property
    def work(self) -> Path:
        """Scratch space of plans being made; emptied when the daemon starts."""
        return self.root / "work"

    @property
    def slices(self) -> Path:
        return self.root / "slices"

    def job(self, number: int) -> Path:
        """Where a person finds a job's files by name."""
        return self.root / "jobs" / str(number)

    @property
    def lock(self) -> Path:
        return self.root / "lock"

    @property
    def log(self) -> Path:
        return self.root / "daemon.log"

    @property
    def clock(self) -> Path:
        return self.root / "clock.json"

    @property
    def told(self) -> Path:
        """What people were notified of."""
        return self.root / "told.json"

    def agent(self, printer: str) -> Path:
        return self.root / "agents" / printer

    def make(self) -> None:
        """Create what is missing. Raises FarmError where that cannot be done."""
        try:
            self.root.mkdir(mode=0o700, parents=True, exist_ok=True)
            for folder in (self.files, self.work, self.slices, self.root / "agents"):
                folder.mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            raise FarmError(
                f"the state folder {self.root} cannot be used ({error}); give another with --state"
            ) from error


@dataclass(frozen=True, slots=True)
class Places:
    """The three paths that every command takes: `--state`, `--socket`, `--fleet`."""

    state: StateFolder
    socket: Path
    fleet: Path


def find_places(
    state: Path | None,
    socket: Path | None,
    fleet: Path | None,
    env: Mapping[str, str] = os.environ,
    shared: Path = SHARED_SOCKET,
) -> Places:
    """Flags first, then the environment, then the XDG folders.

    Where a state folder was named but no socket, the socket lies in that folder, so that two farms on one
    host never meet. Where nothing was named, and this user has no farm that is up, it is the shared one's.

    Raises
    ------
    Refused
        Where the socket has to lie in the system's temporary folder, and another user could put one there.
    """
    home = Path(env.get("HOME", "/"))
    named = state or (Path(env["FARM_STATE"]) if env.get("FARM_STATE") else None)
    root = named or Path(env.get("XDG_STATE_HOME") or home / ".local/state") / "farm"
    root = root.absolute()
    if socket is None and env.get("FARM_SOCKET"):
        socket = Path(env["FARM_SOCKET"])
    if socket is None:
        runtime = env.get("XDG_RUNTIME_DIR")
        socket = Path(runtime) / "farm" / "farm.sock" if runtime and named is None else root / "farm.sock"
        if named is None and not socket.exists() and shared.parent.is_dir():
            socket = shared
    socket = socket.absolute()
    if len(os.fsencode(socket)) > _LONGEST_SOCKET_PATH:
        digest = hashlib.sha256(os.fsencode(socket)).hexdigest()[:16]
        runtime = env.get("XDG_RUNTIME_DIR")
        base = Path(runtime) if runtime else _make_private_folder(f"farm-{os.getuid()}")
        socket = base / f"farm-{digest}.sock"
    if fleet is None and env.get("FARM_FLEET"):
        fleet = Path(env["FARM_FLEET"])
    if fleet is None:
        config = Path(env.get("XDG_CONFIG_HOME") or home / ".config") / "farm" / "fleet.yaml"
        candidates = (Path("fleet.yaml"), config, Path("/etc/farm/fleet.yaml"))
        fleet = next((path for path in candidates if path.is_file()), candidates[0])
    return Places(StateFolder(root), socket, fleet.absolute())


def _make_private_folder(name: str) -> Path:
    """Create a folder in the system's temporary folder, for this user alone; there, others cannot replace it.

    Raises
    ------
    Refused
        Where what has this name belongs to another user, or can be changed by others.
    """
    folder = Path(tempfile.gettempdir()) / name
    how = "remove it, or name a shorter --socket"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise Refused(f"{folder} cannot be used for the farm's socket ({error}): {how}") from error
    if not stat.S_ISDIR(found.st_mode):
        raise Refused(f"{folder} is no folder, so the farm's socket cannot be trusted there: {how}")
    if found.st_uid != os.getuid():
        raise Refused(f"{folder} belongs to another user, who could answer for the farm: {how}")
    if found.st_mode & 0o077:
        raise Refused(f"{folder} is open to other users (mode {found.st_mode & 0o777:o}): {how}")
    return folder


def read_anchor(path: Path) -> tuple[float, float] | None:
    """Scale and anchor of the farm's clock as last written; None where there is none."""
    try:
        saved = json.loads(path.read_text())
        return float(saved["scale"]), float(saved["anchor_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_anchor(path: Path, scale: float, anchor_s: float) -> None:
    """Keep the clock, whole or not at all."""
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps({"scale": scale, "anchor_s": anchor_s}))
    temporary.replace(path)
