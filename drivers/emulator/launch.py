"""Functions that start an emulator, find a running one, and act as a person at the printer."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any

import drivers
from drivers.clock import Clock
from drivers.emulator.faults import parse_url
from drivers.emulator.status import EmulatorStatus, read_status
from drivers.errors import PortError
from drivers.locks import is_locked

__all__ = ["Command", "EmulatorStatus", "control", "is_running", "launch", "read_status"]

TTY_LINK = "tty"
LOG_FILE = "emulator.log"
ALIVE_LOCK = "emulator.lock"  # held by the emulator while it runs
LAUNCH_LOCK = "launch.lock"  # held by a process that starts an emulator
CONTROL_SOCKET = "control.sock"
START_TIMEOUT_S = 20.0
CONTROL_TIMEOUT_S = 5.0


class Command(StrEnum):
    """Command to an emulator: an action of a person at the printer, or a fault."""

    CLEAR_BED = "clear_bed"
    RESET = "reset"
    POWER_OFF = "power_off"
    SET_NOZZLE = "set_nozzle"  # turns the knob to target_c
    SET_BED = "set_bed"
    MOVE = "move"  # moves the bed to z_mm
    PRINT_SD = "print_sd"
    UNPLUG = "unplug"  # pulls the USB cable; the printer continues
    BREAK = "break"  # triggers one of `COUNTED_FAULTS`
    PLUG = "plug"  # the device gets another name


def launch(url: str, folder: Path, clock: Clock) -> Path:
    """Return the port of this folder's emulator; start one if none is running.

    The emulator runs in its own process session and outlives the caller.

    Parameters
    ----------
    url
        ``sim://MODEL?FAULT=VALUE&seed=N``; ignored if an emulator is running.
    folder
        Folder for the emulator's port (`tty`), status, log and control socket; created if missing.
    clock
        The farm's clock.

    Returns
    -------
    Path
        The pseudo-terminal to open: a link in the folder that stays the same.

    Raises
    ------
    PortError
        The url is wrong, or the emulator does not start.
    """
    address = parse_url(url)
    folder.mkdir(parents=True, exist_ok=True)
    with _lock_file(folder / LAUNCH_LOCK):
        if is_running(folder):
            return folder / TTY_LINK
        arguments = ["--model", address.profile.model, "--folder", str(folder.absolute()), "--detach"]
        arguments += ["--scale", repr(clock.scale), "--anchor", repr(clock.anchor_s)]
        arguments += ["--seed", str(address.seed)]
        arguments += [word for fault in address.fault_arguments for word in ("--fault", fault)]
        try:
            _run_emulator(arguments, folder / LOG_FILE)
        except (OSError, subprocess.SubprocessError) as error:
            raise PortError(
                f"{url}: the emulator did not start ({error}); see {folder / LOG_FILE}"
            ) from error
    return folder / TTY_LINK


def _run_emulator(arguments: Sequence[str], log_file: Path) -> None:
    """Run the emulator's program, which forks the emulator and ends once the port exists."""
    with log_file.open("ab") as log:
        subprocess.run(
            [sys.executable, "-m", "drivers.emulator", *arguments],
            cwd=Path(drivers.__file__).parents[1],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
            timeout=START_TIMEOUT_S,
            check=True,
        )


def is_running(folder: Path) -> bool:
    """Return True if an emulator of this folder is running, that is, if its lock is held."""
    return is_locked(folder / ALIVE_LOCK)


def control(folder: Path, command: Command | str, **values: float | str) -> dict[str, Any]:
    """Execute a command on an emulator, and return its answer; for `POWER_OFF`, wait until it has ended.

    Raises
    ------
    PortError
        No emulator answers, or it refuses the command.
    """
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(CONTROL_TIMEOUT_S)
            with shorten_path(folder) as short_path:
                connection.connect(f"{short_path}/{CONTROL_SOCKET}")
            connection.sendall(json.dumps({"do": str(command), **values}).encode() + b"\n")
            with connection.makefile("rb") as answers:
                answer: dict[str, Any] = json.loads(answers.readline())
    except (OSError, ValueError) as error:
        raise PortError(f"{folder}: no emulator answers ({error}); is it running?") from error
    if answer.get("error"):
        raise PortError(f"{folder}: {answer['error']}")
    if command == Command.POWER_OFF:
        _wait_for_end(folder)
    return answer


def _wait_for_end(folder: Path) -> None:
    """Wait until the lock is free, which shows that the process has ended and changes no more files."""
    deadline_s = time.monotonic() + CONTROL_TIMEOUT_S
    while is_running(folder):
        if time.monotonic() > deadline_s:
            raise PortError(f"{folder}: the emulator does not end; see {folder / LOG_FILE}")
        time.sleep(0.005)


@contextlib.contextmanager
def shorten_path(folder: Path) -> Iterator[str]:
    """Provide a path to a folder of any depth that fits into the 108 bytes of a Unix socket's address."""
    descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{descriptor}"
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _lock_file(path: Path) -> Iterator[None]:
    with path.open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
