"""Emergency stop: it switches a printer's heaters off without the agent and the daemon, which may hang.

1. The agent is killed, as a stopped or hung process answers no request. This also frees the port.
2. The agent's lock is taken, so that no other agent starts meanwhile.
3. The board gets the abort sequence (`abort`) and at once a reset by DTR, which switches heaters, motors and
   fan off; a board that DTR does not reset has received the sequence.
4. M105 is sent until both reported targets are 0. If the board did not restart, M114 is sent until two
   positions are equal; then its motors are switched off. M105 is sent until both heaters cool
   (`HeaterWatch`): only then do they count as off.
5. A record in the agent's journal requires a person to check the printer: nothing is printed before
   `farm cleared`.
6. If the heaters were not confirmed off and the fleet has a `power_off_cmd`, the mains are cut.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.emulator.launch import TTY_LINK
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.errors import AgentError, DriverError, PortError
from drivers.firmware import Firmware
from drivers.gcode import HeaterName
from drivers.link import BoardConnected, Event, Link, Report, UnknownLine
from drivers.link.dialogue import exchange
from drivers.locks import AGENT_LOCK, acquire_lock, kill_holder
from drivers.ports import NET_PREFIX, NetPort, Port, SerialPort
from drivers.printers import find_firmware
from drivers.records import ESTOP_REASON, JOURNAL, Journal, StartFile
from drivers.safety.abort import send_abort
from drivers.safety.heater_watch import HeaterWatch
from drivers.safety.mains import cut_mains

EMULATOR_FOLDER = "emulator"
_REPORT_TIMEOUT_S = 20.0  # time for `start`, the banner and a report
_POLL_INTERVAL_S = 0.5  # time between two reports, and between two queries for the position
_COOLING_TIMEOUT_S = 120.0  # longer than `HeaterWatch` needs to find a heater that does not cool
_EXECUTED_STEPS = re.compile(rb"Count (X.*)")  # the position of the head in the answer to M114
_FIELD_NAMES = {
    "cut_s": "reset_s",
    "seen_off": "is_confirmed_off",
    "still": "is_still",
}  # fields by their names in JSON

ProgressCallback = Callable[[str], None]
"""Callback for progress messages during a stop."""


def _ignore_progress(text: str) -> None:
    """Ignore a progress message."""


@dataclass(frozen=True, slots=True)
class StopTarget:
    """A printer to stop.

    Attributes
    ----------
    printer
        The printer's name in the fleet.
    port
        The printer's port, as in `fleet.yaml`.
    folder
        The folder of its agent.
    firmware
        The printer's firmware.
    power_off_cmd
        Command that cuts the printer's mains; see `PowerOffRun`.
    """

    printer: str
    port: str
    folder: Path
    firmware: Firmware
    power_off_cmd: str | None = None

    @classmethod
    def from_agent(cls, start: StartFile, folder: Path) -> StopTarget:
        """Build the target from the start file of an agent in `folder`."""
        return cls(start.printer, start.port, folder, find_firmware(start.model), start.power_off_cmd)


@dataclass(frozen=True, slots=True)
class StopResult:
    """Result of an emergency stop.

    Attributes
    ----------
    printer
        The printer's name in the fleet.
    reset_s
        Wall time (time.time) of the reset, in seconds; None if it was not possible.
    is_confirmed_off
        True if the printer reported both targets 0 and has cooled since then, or if it is a simulated printer
        without power.
    text
        User-facing sentence.
    is_still
        True if the printer was confirmed not to move: it restarted, or M114 returned the same position twice.
    """

    printer: str
    reset_s: float | None
    is_confirmed_off: bool
    text: str
    is_still: bool = False

    def dump(self) -> str:
        """Serialise the result as one line of JSON, whose names are the same in all versions."""
        return json.dumps(
            {
                "printer": self.printer,
                "cut_s": self.reset_s,
                "seen_off": self.is_confirmed_off,
                "text": self.text,
                "still": self.is_still,
            }
        )

    @classmethod
    def parse(cls, line: bytes | str) -> StopResult:
        """Parse a result. Raises ValueError or TypeError if it is not one."""
        fields: dict[str, Any] = dict(json.loads(line))
        return cls(**{_FIELD_NAMES.get(name, name): value for name, value in fields.items()})


def list_targets(agents_folder: Path) -> dict[str, StopTarget]:
    """Find all printers whose agents have a start file, by name."""
    targets = {}
    for folder in sorted(agents_folder.glob("*/")):
        with suppress(AgentError):
            targets[folder.name] = replace(
                StopTarget.from_agent(StartFile.read(folder), folder), printer=folder.name
            )
    return targets


def stop_printer(
    target: StopTarget,
    report_timeout_s: float = _REPORT_TIMEOUT_S,
    notify: ProgressCallback = _ignore_progress,
) -> StopResult:
    """Stop one printer. Never raises; returns once the printer cools, after at most 140 s.

    Parameters
    ----------
    target
        The printer.
    report_timeout_s
        Wall seconds within which the printer has to report both targets 0.
    notify
        Function that is called with the first result, before the printer has cooled.
    """
    with suppress(OSError):  # a process of another user cannot be killed, and its port stays in use
        kill_holder(target.folder / AGENT_LOCK)
    lock = None
    with suppress(OSError):
        target.folder.mkdir(parents=True, exist_ok=True)
        lock = acquire_lock(target.folder / AGENT_LOCK)
    try:
        result = stop_board(target, report_timeout_s, notify)
        if lock is not None:
            with suppress(DriverError, OSError):  # on a full disk, the bed counts as unknown in any case
                Journal(target.folder / JOURNAL).write(
                    time.time(), look=ESTOP_REASON, hot=not result.is_confirmed_off
                )
    finally:
        if lock is not None:
            os.close(lock)
    return result


def stop_board(
    target: StopTarget,
    report_timeout_s: float = _REPORT_TIMEOUT_S,
    notify: ProgressCallback = _ignore_progress,
) -> StopResult:
    """Stop the board of a printer without an agent; cut the mains if that fails. Never raises.

    Parameters
    ----------
    target, report_timeout_s, notify
        See `stop_printer`.
    """
    result = _reset_board(target, report_timeout_s, notify)
    if result.is_confirmed_off or not target.power_off_cmd:
        return result
    return replace(result, text=f"{result.text}; {cut_mains(target.power_off_cmd, target.printer)}")


def _reset_board(target: StopTarget, report_timeout_s: float, notify: ProgressCallback) -> StopResult:
    """Reset the board and confirm that its heaters are off."""
    name = target.printer
    try:
        port = _open_port(target)
    except PortError as error:
        return StopResult(name, None, False, f"cannot be stopped ({error}); switch the printer off")
    if port is None:
        text = f"is switched off: no emulator in {target.folder}"
        return StopResult(name, time.time(), True, text, is_still=True)
    reset_s, board = None, _Board(port, target.firmware, notify)
    try:
        send_abort(port, target.firmware)
        if not target.port.startswith("sim://"):  # opening the port of an emulator was the reset
            with suppress(PortError):  # the abort sequence may have sufficed, which is checked below
                port.reset()
        reset_s = time.time()
        text, heaters_off = board.confirm_heaters_off(report_timeout_s)
    except PortError as error:
        text, heaters_off = f"{error}; switch the printer off", False
    finally:
        port.close()
    return StopResult(name, reset_s, heaters_off, f"{text}; {board.motion_text}", board.is_still)


def _open_port(target: StopTarget) -> Port | None:
    """Open the printer's port; None if it is simulated and without power. Raises PortError."""
    path = Path(target.port)
    if target.port.startswith("sim://"):
        emulator = target.folder / EMULATOR_FOLDER
        if not emulator_is_running(emulator):
            return None
        path = emulator / TTY_LINK
    elif target.port.startswith(NET_PREFIX):
        return NetPort(target.port, target.firmware.baud_rate)
    try:
        return SerialPort(path, target.firmware.baud_rate)
    except PortError:
        # Open the port even if another process uses it.
        return SerialPort(path, target.firmware.baud_rate, is_shared=True)


class _Board:
    """Board that was stopped, and its answers since then.

    Attributes
    ----------
    is_still
        True if the board was confirmed to have stopped all motion.
    """

    def __init__(self, port: Port, firmware: Firmware, notify: ProgressCallback) -> None:
        self.is_still = False
        self._port, self._notify = port, notify
        self._firmware = firmware
        self._link = Link(firmware)
        self._link.ignore_faults = True
        self._link.poll_interval_s = _POLL_INTERVAL_S
        self._connection: BoardConnected | None = None
        self._report: Report | None = None
        self._position: bytes | None = None
        self._has_waited_for_moves = False  # True once the board was told to wait for all moves

    @property
    def motion_text(self) -> str:
        """User-facing clause on the motion of the board."""
        return "it stands still" if self.is_still else "it may still be moving: check it"

    def confirm_heaters_off(self, report_timeout_s: float) -> tuple[str, bool]:
        """Poll until both targets are 0 and the heaters cool.

        Returns
        -------
        (str, bool)
            A user-facing sentence; True if the heaters were confirmed off.
        """
        for now_s, event in exchange(
            self._port, self._link, report_timeout_s, unconfirmed_commands=self._firmware.unnumbered_abort
        ):
            self._on_event(now_s, event)
            if self.is_still and self._report is not None and self._report.targets_off:
                break
        if (self._report is None or not self._report.targets_off) and self._firmware.halt_command is not None:
            self._port.write_now(b"\n" + self._firmware.halt_command + b"\n")  # the print is lost in any case
        if self._report is None or self._connection is None:
            return "was reset, but reports no temperatures: switch it off", False
        report, connection = self._report, self._connection
        if not report.targets_off:
            targets = f"nozzle {report.nozzle_target_c:g} C, bed {report.bed_target_c:g} C"
            return f"still reports targets ({targets}): switch it off", False
        method = "its board was reset" if connection.has_restarted else "by command: its board was not reset"
        with suppress(OSError):  # the message may have no reader, but the printer must be watched
            self._notify(f"reports targets of 0 ({method}), {self.motion_text}; it is watched until it cools")
        return self._confirm_cooling(method)

    def _on_event(self, now_s: float, event: Event) -> None:
        if isinstance(event, BoardConnected):
            self._connection = event
            if event.has_restarted:
                self.is_still = True
            else:  # repeat the abort with line numbers, as the one without numbers may have been lost
                self._link.send(now_s, *self._firmware.abort_commands)
            self._link.poll(now_s)
        elif isinstance(event, Report):
            self._report = event
            if not self.is_still and self._link.is_drained:
                self._check_motion(now_s)
        elif isinstance(event, UnknownLine) and (match := _EXECUTED_STEPS.search(event.text)) is not None:
            if match[1] == self._position and not self.is_still:
                self.is_still = True
                self._link.send(now_s, self._firmware.motors_off_command)
            self._position = match[1]

    def _check_motion(self, now_s: float) -> None:
        """Query the head's position; if the firmware does not report motion, wait for all moves instead."""
        if self._firmware.reports_executed_steps:
            self._link.send(now_s, self._firmware.position_query)
        elif self._has_waited_for_moves:
            self.is_still = True
            self._link.send(now_s, self._firmware.motors_off_command)
        else:
            self._has_waited_for_moves = True
            self._link.send(now_s, self._firmware.wait_command)

    def _confirm_cooling(self, method: str) -> tuple[str, bool]:
        watch, report = HeaterWatch(0.0), self._report
        assert report is not None
        for now_s, event in exchange(self._port, self._link, _COOLING_TIMEOUT_S, is_new=False):
            self._on_event(now_s, event)
            if isinstance(event, Report):
                report = event
                finding = watch.judge_report(event, dict.fromkeys(HeaterName, 0.0), now_s)
                if finding is not None or not event.targets_off:
                    break
                if watch.is_cooling:
                    temperatures = f"nozzle {event.nozzle_c:g} C, bed {event.bed_c:g} C"
                    return f"heaters confirmed off and cooling ({method}; {temperatures})", True
        temperatures = f"nozzle {report.nozzle_c:g} C, bed {report.bed_c:g} C"
        return f"reports targets of 0, but cooling was not confirmed ({temperatures}): switch it off", False
