"""Emergency stop of printers on another host, over one connection."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

from drivers.host.messages import HostRequest, HostTask
from drivers.records import StartFile
from drivers.remote import build_ssh_command
from drivers.safety import StopResult

_STOP_TIMEOUT_S = 200.0  # wall seconds for all emergency stops


def stop_printers_on_host(
    host: str,
    command: str,
    farm: str,
    starts: Sequence[StartFile],
    on_result: Callable[[StopResult], None],
    timeout_s: float = _STOP_TIMEOUT_S,
) -> None:
    """Stop printers on another host. Never raises; each printer gets one result.

    Parameters
    ----------
    host, command
        The host, and the command that runs `farm host` there.
    farm
        Name of the farm.
    starts
        Start files of the printers' agents.
    on_result
        Function that is called with each result as soon as it is known.
    timeout_s
        Wall seconds for all results.
    """
    request = HostRequest(do=HostTask.STOP, farm=farm, starts=tuple(starts))
    unreported_printers, reason = {start.printer for start in starts}, "no result"

    def take_result(result: StopResult) -> None:
        if result.printer in unreported_printers:
            unreported_printers.remove(result.printer)
            on_result(result)

    try:
        with subprocess.Popen(
            build_ssh_command(host, command),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as process:
            reason = _exchange_messages(process, request, take_result, timeout_s) or reason
    except (OSError, ValueError, TypeError) as error:
        reason = str(error)
    for printer in sorted(unreported_printers):
        on_result(
            StopResult(printer, None, False, f"cannot be stopped ({host}: {reason}); switch the printer off")
        )


def _exchange_messages(
    process: subprocess.Popen[bytes],
    request: HostRequest,
    on_result: Callable[[StopResult], None],
    timeout_s: float,
) -> str | None:
    """Send a request to a process and read its results; return the last line of its errors, if any."""
    assert process.stdin is not None and process.stdout is not None and process.stderr is not None
    timer = threading.Timer(timeout_s, process.kill)
    timer.start()
    try:
        with suppress(BrokenPipeError):  # the reason is in the output of ssh on stderr
            process.stdin.write(request.serialise())
            process.stdin.close()
        for line in process.stdout:
            on_result(StopResult.parse(line))
        errors = process.stderr.read().decode(errors="replace").strip().splitlines()
        return errors[-1] if errors else None
    finally:
        timer.cancel()
        process.kill()
