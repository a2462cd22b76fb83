"""Ends a printer's heat from outside, whatever its agent and the daemon are doing.

1. The agent is killed: a stopped or hung process asks for nothing, and its death gives the port free.
2. Its lock is taken, so that no other agent comes up in between.
3. The board is reset, by DTR, which switches heaters, motors and fan off at once.
4. M105 is asked until a report shows both targets 0, and then until both heaters cool (`Watch`): only that
   is called off. A board that did not start again is told M104 S0 and M140 S0 as well.
5. The agent's journal says that a person has to look: nothing is printed there before `farm cleared`.
6. What could not be shown off is taken from the mains, where the fleet has a `power_off_cmd`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drivers import mains, start
from drivers.agent.journal import ESTOPPED, JOURNAL, Journal
from drivers.emulator.launch import TTY
from drivers.emulator.launch import alive as emulator_alive
from drivers.errors import AgentError, DriverError, PortError
from drivers.gcode import HeaterName
from drivers.locks import AGENT_LOCK, hold, kill_holder
from drivers.marlin import Link, Report, Up
from drivers.ports import NET, NetPort, Port
from drivers.serialport import SerialPort
from drivers.talk import talk
from drivers.watch import Watch

EMULATOR = "emulator"
_SHOW_S = 20.0  # for `start`, the banner and a report
_ASK_S = 0.5
_COOL_S = 120.0  # `Watch` finds before that what does not cool


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


@dataclass(frozen=True, slots=True)
class Stopped:
    """What came of it.

    Attributes
    ----------
    cut_s
        Wall seconds (time.time) at which the board had been reset; None where that could not be done.
    seen_off
        The printer itself has shown both targets 0 and cooled since, or it is a simulated one without power.
    text
        One sentence for a person.
    """

    printer: str
    cut_s: float | None
    seen_off: bool
    text: str


def known(agents: Path) -> dict[str, Target]:
    """The printers whose agents have left word in their folders."""
    found = {}
    for folder in sorted(agents.glob("*/")):
        with suppress(AgentError):
            begun = start.read(folder)
            found[folder.name] = Target(folder.name, begun.port, folder, begun.power_off_cmd)
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
        return Stopped(name, time.time(), True, f"is switched off: no emulator of it in {target.folder}")
    cut_s = None
    try:
        if not target.port.startswith("sim://"):  # else opening was the reset
            port.reset()
        cut_s = time.time()
        text, seen = _show(port, show_s, tell)
    except PortError as error:
        text, seen = f"{error}; switch it off", False
    finally:
        port.close()
    return Stopped(name, cut_s, seen, text)


def _open(target: Target) -> Port | None:
    path = Path(target.port)
    if target.port.startswith("sim://"):
        emulator = target.folder / EMULATOR
        if not emulator_alive(emulator):
            return None
        path = emulator / TTY
    elif target.port.startswith(NET):
        return NetPort(target.port)
    try:
        return SerialPort(path)
    except PortError:
        return SerialPort(path, shared=True)  # whoever has it: this comes first


def _show(port: Port, show_s: float, tell: Tell) -> tuple[str, bool]:
    """Whether the heaters were seen off, and what is to be said of it."""
    link, up, report, watch = Link(), None, None, Watch(0.0)
    link.only_ask = True
    link.poll_every_s = _ASK_S
    for now_s, event in talk(port, link, show_s):
        if isinstance(event, Up):
            up = event
            if not event.restarted:
                link.send(now_s, b"M104 S0", b"M140 S0")
            link.poll(now_s)
        elif isinstance(event, Report):
            report = event
            if up is not None and event.off:
                break
    if report is None or up is None:
        return "was reset, but shows no temperatures: switch it off", False
    if not report.off:
        heats = f"nozzle {report.nozzle_target_c:g} C, bed {report.bed_target_c:g} C"
        return f"still shows targets ({heats}): switch it off", False
    how = "its board was reset" if up.restarted else "by command: its board was not reset"
    with suppress(OSError):  # nobody listens any more: it is watched all the same
        tell(f"shows both targets 0 ({how}); it is watched until it cools")
    for now_s, event in talk(port, link, _COOL_S, anew=False):
        if isinstance(event, Report):
            report = event
            finding = watch.look(event, dict.fromkeys(HeaterName, 0.0), now_s)
            if finding is not None or not event.off:
                break
            if watch.cools:
                now = f"nozzle {event.nozzle_c:g} C, bed {event.bed_c:g} C"
                return f"heaters seen off and cooling ({how}; {now})", True
    now = f"nozzle {report.nozzle_c:g} C, bed {report.bed_c:g} C"
    return f"shows targets 0, but was not seen to cool ({now}): switch it off", False
