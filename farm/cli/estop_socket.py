"""Emergency stop for users without access to the agents, over a separate socket and without the daemon.

A member of the socket's group sends the names of printers. For each request, `farm.cli.estop_server` starts a
process under the farm's user. The process stops these printers, and reports line by line
(`deploy/systemd/farm-estop.socket`).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TextIO

from pydantic import BaseModel, ConfigDict, TypeAdapter

from farm.errors import ErrorCode, FarmError
from farm.paths import FarmPaths

_MAX_LINE_BYTES = 1 << 16
_SILENCE_TIMEOUT_S = 180.0  # maximum time between two lines; a hot printer is watched for 140 s


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid")


class StopRequest(_Line):
    """Request to stop the named printers; an empty list means all printers."""

    printers: list[str]


class StopReport(_Line):
    """Progress or outcome of the stop of one printer."""

    printer: str
    seen_off: bool | None = None  # whether the heaters are confirmed off; null until that is known
    still: bool | None = None  # true if the printer is confirmed to stand still
    reset_after_s: float | None = None
    text: str


class StopEnd(_Line):
    """Last line of the response."""

    over: Literal[True]
    error: str | None = None
    code: ErrorCode | None = None


ReportCallback = Callable[[StopReport], None]
_RESPONSE_LINE: TypeAdapter[StopReport | StopEnd] = TypeAdapter(StopReport | StopEnd)


def find_estop_socket(paths: FarmPaths) -> Path | None:
    """Find the emergency socket of a farm that belongs to another user; return None for a farm of this user.

    Root uses the socket of another user's farm too, unless `paths` names an existing state folder.

    Raises
    ------
    FarmError
        If the farm belongs to another user and has no emergency socket: this user cannot reach its agents.
    """
    path = paths.socket.with_name("estop.sock")
    owners = {owner for socket in (path, paths.socket) if (owner := _find_owner(socket)) is not None}
    is_root_with_state_folder = os.geteuid() == 0 and (paths.state.root / "agents").is_dir()
    if is_root_with_state_folder or owners <= {os.geteuid()}:
        return None
    if _find_owner(path) is None:
        raise FarmError(
            f"the farm at {paths.socket} belongs to another user and has no estop.sock: ask its owner to "
            "stop its printers, or switch them off by hand"
        )
    return path


def _find_owner(path: Path) -> int | None:
    try:
        return path.stat().st_uid
    except OSError:
        return None


def request_stop(path: Path, printers: list[str], report: ReportCallback) -> None:
    """Send a stop request over the socket, and report each line of the response.

    Raises
    ------
    FarmError
        If there is no response, or the stop fails.
    """
    message = f"{path}: the stop failed ({{}}); switch the printers off by hand"
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(_SILENCE_TIMEOUT_S)
            connection.connect(str(path))
            connection.sendall(StopRequest(printers=printers).model_dump_json().encode() + b"\n")
            with connection.makefile("r", encoding="utf-8") as lines:
                for line in lines:
                    response = _RESPONSE_LINE.validate_json(line)
                    if isinstance(response, StopEnd):
                        if response.error is not None:
                            raise FarmError(response.error, response.code)
                        return
                    report(response)
    except PermissionError as error:
        raise FarmError(message.format("only members of its group may use it")) from error
    except (OSError, ValueError) as error:  # ValueError: a line of the response is not valid
        raise FarmError(message.format(error)) from error
    raise FarmError(message.format("the response ended before the result"))


def serve_request(
    request: TextIO, responses: TextIO, stop: Callable[[list[str], ReportCallback], None]
) -> None:
    """Serve one stop request and report line by line; continue the stop if the caller disconnects."""

    def send(line: BaseModel) -> None:
        try:
            responses.write(line.model_dump_json() + "\n")
            responses.flush()
        except OSError:
            pass

    try:
        request_body = StopRequest.model_validate_json(request.readline(_MAX_LINE_BYTES))
    except ValueError:
        send(StopEnd(over=True, error="the request cannot be read", code=ErrorCode.REFUSED))
        return
    end = StopEnd(over=True)
    try:
        stop(request_body.printers, send)
    except FarmError as error:
        end = StopEnd(over=True, error=str(error), code=error.code)
    send(end)
