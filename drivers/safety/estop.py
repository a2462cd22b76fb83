"""Ends a printer's heat from outside, whatever its agent and the daemon are doing.

1. The agent is killed: a stopped or hung process asks for nothing, and its death gives the port free.
2. Its lock is taken, so that no other agent comes up in between.
3. The board is told to end motion and heat (`last_words`), and reset at once, by DTR, which switches heaters,
   motors and fan off; a board that DTR does not reset has heard the words.
4. M105 is asked until a report shows both targets 0, and M114, where it did not start again, until the head
   was twice at the same place; then the motors go off. M105 is asked on until both heaters cool (`Watch`):
   only that is called off.
5. The agent's journal says that a person has to look: nothing is printed there before `farm cleared`.
6. What could not be shown off is taken from the mains, where the fleet has a `power_off_cmd`.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.emulator.launch import TTY
from drivers.emulator.launch import alive as emulator_alive
from drivers.errors import AgentError, DriverError, PortError
from drivers.firmware import ULTIMAKER2, Firmware
from drivers.gcode import HeaterName
from drivers.link import Event, Link, Report, Said, Up
from drivers.link.dialogue import talk
from drivers.locks import AGENT_LOCK, hold, kill_holder
from drivers.ports.port import NET, NetPort, Port
from drivers.ports.serial_port import SerialPort
from drivers.printers import firmware_of
from drivers.records import ESTOPPED, JOURNAL, Journal, StartFile
from drivers.safety import mains
from drivers.safety.heater_watch import Watch
from drivers.safety.last_words import end_blind

EMULATOR = "emulator"
_SHOW_S = 20.0  # for `start`, the banner and a report
_ASK_S = 0.5  # between two reports, and two questions where the head is
_COOL_S = 120.0  # `Watch` finds before that what does not cool
_COUNT = re.compile(rb"Count (X.*)")  # where the head is, of M114's answer


Tell = Callable[[str], None]


def _say_nothing(text: str) -> None:
    """For whoever only wants to know how it ended."""


@dataclass(frozen=True, slots=True)
class Target:
    """A printer to stop, as `fleet.yaml` has it or as its last agent wrote it down."""

    printer: str
    port: str
    folder: Path
    power_off_cmd: str | None = None
    firmware: Firmware = ULTIMAKER2


@dataclass(frozen=True, slots=True)
class Stopped:
    """Outcome of an emergency stop.

    Attributes
    ----------
    cut_s
        Wall seconds (time.time) at which the board had been reset; None where that could not be done.
    seen_off
        The printer itself has shown both targets 0 and cooled since, or it is a simulated one without power.
    still
        It was seen not to move any more: it started anew, or M114 named the same place twice.
    text
        One sentence for a person.
    """

    printer: str
    cut_s: float | None
    seen_off: bool
    text: str
    still: bool = False


def known(agents: Path) -> dict[str, Target]:
    """The printers whose agents have left word in their folders."""
    found = {}
    for folder in sorted(agents.glob("*/")):
        with suppress(AgentError):
            begun = StartFile.read(folder)
            found[folder.name] = Target(
                folder.name, begun.port, folder, begun.power_off_cmd, firmware_of(begun.model)
            )
    return found


def stop(target: Target, show_s: float = _SHOW_S, tell: Tell = _say_nothing) -> Stopped:
    """Stop one printer. Never raises; takes as long as it takes to see that it cools, 140 s at most.

    Parameters
    ----------
    target
        The printer.
    show_s
        Wall seconds in which it has to show both targets 0.
    tell
        Hears in the meantime what a person wants to know.
    """
    with suppress(OSError):  # another user's: its port is not free then
        kill_holder(target.folder / AGENT_LOCK)
    lock = None
    with suppress(OSError):
        target.folder.mkdir(parents=True, exist_ok=True)
        lock = hold(target.folder / AGENT_LOCK)
    try:
        stopped = cut(target, show_s, tell)
        if lock is not None:
            with suppress(DriverError, OSError):  # a full disk: the next agent doubts the bed all the same
                Journal(target.folder / JOURNAL).write(time.time(), look=ESTOPPED, hot=not stopped.seen_off)
    finally:
        if lock is not None:
            os.close(lock)
    return stopped


def cut(target: Target, show_s: float = _SHOW_S, tell: Tell = _say_nothing) -> Stopped:
    """The same where no agent lives: the board, and where that does not help the mains. Never raises."""
    stopped = _reset(target, show_s, tell)
    if stopped.seen_off or not target.power_off_cmd:
        return stopped
    return replace(stopped, text=f"{stopped.text}; {mains.cut(target.power_off_cmd, target.printer)}")


def _reset(target: Target, show_s: float, tell: Tell) -> Stopped:
    """Reset the board and see its heaters off."""
    name = target.printer
    try:
        port = _open(target)
    except PortError as error:
        return Stopped(name, None, False, f"cannot be stopped: {error}; switch it off")
    if port is None:
        text = f"is switched off: no emulator of it in {target.folder}"
        return Stopped(name, time.time(), True, text, still=True)
    cut_s, board = None, _Board(port, target.firmware, tell)
    try:
        end_blind(port, target.firmware)
        if not target.port.startswith("sim://"):  # else opening was the reset
            with suppress(PortError):  # the words may have ended it; what has gone is seen below
                port.reset()
        cut_s = time.time()
        text, seen = board.show(show_s)
    except PortError as error:
        text, seen = f"{error}; switch it off", False
    finally:
        port.close()
    return Stopped(name, cut_s, seen, f"{text}; {board.motion}", board.still)


def _open(target: Target) -> Port | None:
    path = Path(target.port)
    if target.port.startswith("sim://"):
        emulator = target.folder / EMULATOR
        if not emulator_alive(emulator):
            return None
        path = emulator / TTY
    elif target.port.startswith(NET):
        return NetPort(target.port, target.firmware.baud_rate)
    try:
        return SerialPort(path, target.firmware.baud_rate)
    except PortError:
        return SerialPort(path, target.firmware.baud_rate, shared=True)  # whoever has it: this comes first


class _Board:
    """A board that was told to stop, and what it shows of that.

    Attributes
    ----------
    still
        It was seen not to move.
    """

    def __init__(self, port: Port, firmware: Firmware, tell: Tell) -> None:
        self.still = False
        self._port, self._tell = port, tell
        self._firmware = firmware
        self._link = Link(firmware)
        self._link.only_ask = True
        self._link.poll_every_s = _ASK_S
        self._up: Up | None = None
        self._report: Report | None = None
        self._place: bytes | None = None

    @property
    def motion(self) -> str:
        """Say what was seen of its motion."""
        return "it stands still" if self.still else "it was not seen to stand still: look whether it moves"

    def show(self, show_s: float) -> tuple[str, bool]:
        """Whether its heaters were seen off, and what is to be said of them."""
        for now_s, event in talk(self._port, self._link, show_s, hail=self._firmware.abort_unnumbered):
            self._hear(now_s, event)
            if self.still and self._report is not None and self._report.off:
                break
        if self._report is None or self._up is None:
            return "was reset, but shows no temperatures: switch it off", False
        report, up = self._report, self._up
        if not report.off:
            heats = f"nozzle {report.nozzle_target_c:g} C, bed {report.bed_target_c:g} C"
            return f"still shows targets ({heats}): switch it off", False
        how = "its board was reset" if up.restarted else "by command: its board was not reset"
        with suppress(OSError):  # nobody listens any more: it is watched all the same
            self._tell(f"shows both targets 0 ({how}), {self.motion}; it is watched until it cools")
        return self._cool(how)

    def _hear(self, now_s: float, event: Event) -> None:
        if isinstance(event, Up):
            self._up = event
            if event.restarted:
                self.still = True
            else:  # once more, numbered, as what was sent blind may have been lost
                self._link.send(now_s, *self._firmware.abort)
            self._link.poll(now_s)
        elif isinstance(event, Report):
            self._report = event
            if not self.still and self._link.drained:
                self._link.send(now_s, self._firmware.position_query)
        elif isinstance(event, Said) and (found := _COUNT.search(event.text)) is not None:
            if found[1] == self._place and not self.still:
                self.still = True
                self._link.send(now_s, self._firmware.motors_off)
            self._place = found[1]

    def _cool(self, how: str) -> tuple[str, bool]:
        watch, report = Watch(0.0), self._report
        assert report is not None
        for now_s, event in talk(self._port, self._link, _COOL_S, anew=False):
            self._hear(now_s, event)
            if isinstance(event, Report):
                report = event
                finding = watch.judge(event, dict.fromkeys(HeaterName, 0.0), now_s)
                if finding is not None or not event.off:
                    break
                if watch.cools:
                    now = f"nozzle {event.nozzle_c:g} C, bed {event.bed_c:g} C"
                    return f"heaters seen off and cooling ({how}; {now})", True
        now = f"nozzle {report.nozzle_c:g} C, bed {report.bed_c:g} C"
        return f"shows targets 0, but was not seen to cool ({now}): switch it off", False
