"""Scripts that reset a board, send commands to it and query it. Pure."""

from __future__ import annotations

from collections.abc import Generator

from drivers.errors import Fault
from drivers.link import Phase as LinkPhase
from drivers.session.context import PrintEnded, Script, SessionContext, TimedScript, Wait

SEND_TIMEOUT_S = 180.0  # maximum time for commands to be executed
RESET_TIMEOUT_S = 30.0  # maximum time for a port that disappeared to return
CONNECT_TIMEOUT_S = 30.0  # maximum time for the board to answer; the link sends its queries earlier
MAX_ATTEMPTS = 3  # maximum number of resets before the session gives up
HEATING_DEAD_MAN_TIMEOUT_S = 1200.0  # nothing resets the timer during a G28 or behind slow moves
PRINTING_DEAD_MAN_TIMEOUT_S = 600.0  # moves reset the timer, but an M400 behind 17 slow moves does not
PAUSE_DEAD_MAN_TIMEOUT_S = 120.0  # the session resets the timer every few seconds


def connect(context: SessionContext) -> Script:
    """Reset the board and wait until it answers, with its heaters off and its line count at 0.

    After a restart no dead-man timer is armed. A board that cannot be reset keeps its timer until its heaters
    are reported off, as another host may have armed that timer.
    """
    link = context.link
    for _ in range(MAX_ATTEMPTS):
        context.connection = None
        context.wants_reset = True
        link.poll_interval_s = context.pace.heating_interval_s
        if not (yield context.wait(lambda: not context.wants_reset, RESET_TIMEOUT_S)):
            raise PrintEnded(Fault.PORT_LOST, "the port is missing")
        yield context.wait(
            lambda: context.connection is not None or link.phase is LinkPhase.DEAD, CONNECT_TIMEOUT_S
        )
        connection = context.connection
        if connection is not None and connection.has_restarted:
            context.dead_man_timeout_s = 0.0
            if context.firmware.setup_commands:
                yield from send(context, *context.firmware.setup_commands)
            return
        if connection is not None and not context.can_reset_board:
            yield from send(context, *context.firmware.reset_commands)
            return
    raise PrintEnded(Fault.NO_ANSWER, "the board did not restart when its port was opened")


def send(context: SessionContext, *commands: bytes, limit_s: float = SEND_TIMEOUT_S) -> TimedScript:
    """Send commands and wait until the last of them was executed."""
    context.link.send(context.now_s, *commands)
    context.last_command_at_s = context.now_s
    return (yield context.wait(lambda: context.link.is_drained, limit_s))


def query(context: SessionContext, command: bytes) -> Generator[Wait, bool, bytes]:
    """Send a query, and return the answer."""
    context.answer = b""
    yield from send(context, command)
    return context.answer


def await_report(context: SessionContext, deadline_s: float) -> TimedScript:
    """Wait for the next temperature report."""
    previous = context.report
    return (yield Wait(lambda: context.report is not previous, deadline_s))


def arm_dead_man_timer(context: SessionContext, timeout_s: float) -> Script:
    """Arm the firmware's dead-man timer: heaters go off after that time without a command; 0 disarms it."""
    context.dead_man_timeout_s = max(timeout_s, 10 * context.pace.min_timeout_s) if timeout_s else 0.0
    yield from send(context, context.firmware.dead_man_command % context.dead_man_timeout_s)
