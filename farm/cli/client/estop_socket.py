"""`farm estop` of those who may not touch the agents: a socket of its own, without the daemon.

Whoever may write to the socket names printers; a process of the farm's user, which `estop_server` starts for
each request (`deploy/systemd/farm-estop.socket`), stops them and says line by line what came of it.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TextIO

from pydantic import BaseModel, ConfigDict, TypeAdapter

from farm.errors import ErrorCode, FarmError
from farm.paths import Places

_LONGEST = 1 << 16  # bytes of a line
_PATIENCE_S = 180.0  # without a word; a printer that is hot is watched for 140 s


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Pressed(_Line):
    """Stop these; all where there is none."""

    printers: list[str]


class Said(_Line):
    """What became of a printer."""

    printer: str
    seen_off: bool | None = None  # None: it is still looked at
    still: bool | None = None  # seen not to move any more
    reset_after_s: float | None = None
    text: str


class Over(_Line):
    """All of them have been looked at."""

    over: Literal[True]
    error: str | None = None
    code: ErrorCode | None = None


Say = Callable[[Said], None]
_heard: TypeAdapter[Said | Over] = TypeAdapter(Said | Over)


def way(places: Places) -> Path | None:
    """The socket, where the farm is another user's; None where it is one's own.

    Root goes there too, unless it was told where the farm's state folder is.

    Raises
    ------
    FarmError
        It is another user's and has none: what this user's own folders say is of another farm.
    """
    path = places.socket.with_name("estop.sock")
    owners = {owner for socket in (path, places.socket) if (owner := _owner(socket)) is not None}
    told = os.geteuid() == 0 and (places.state.root / "agents").is_dir()
    if told or owners <= {os.geteuid()}:
        return None
    if _owner(path) is None:
        raise FarmError(
            f"the farm at {places.socket} belongs to another user and has no estop.sock: its owner can stop "
            "its printers, or switch them off by hand"
        )
    return path


def _owner(path: Path) -> int | None:
    try:
        return path.stat().st_uid
    except OSError:
        return None


def press(path: Path, printers: list[str], say: Say) -> None:
    """Have printers stopped.

    Raises
    ------
    FarmError
        Nobody answers there, or what `stop` raised at the other end.
    """
    trouble = f"{path}: cannot be reached ({{}}); switch the printers off by hand"
    try:
        with socket.socket(socket.AF_UNIX) as talk:
            talk.settimeout(_PATIENCE_S)
            talk.connect(str(path))
            talk.sendall(Pressed(printers=printers).model_dump_json().encode() + b"\n")
            with talk.makefile("r", encoding="utf-8") as lines:
                for line in lines:
                    heard = _heard.validate_json(line)
                    if isinstance(heard, Over):
                        if heard.error is not None:
                            raise FarmError(heard.error, heard.code)
                        return
                    say(heard)
    except PermissionError as error:
        raise FarmError(trouble.format("only members of its group may use it")) from error
    except (OSError, ValueError) as error:  # what is no text is no line of ours either
        raise FarmError(trouble.format(error)) from error
    raise FarmError(trouble.format("it ended before it reported the result"))


def answer(asked: TextIO, said: TextIO, stop: Callable[[list[str], Say], None]) -> None:
    """Stop what one line asks for, and say in lines what came of it; whoever asked may have gone."""

    def tell(line: BaseModel) -> None:
        try:
            said.write(line.model_dump_json() + "\n")
            said.flush()
        except OSError:
            pass

    try:
        pressed = Pressed.model_validate_json(asked.readline(_LONGEST))
    except ValueError:
        tell(Over(over=True, error="the request cannot be read", code=ErrorCode.REFUSED))
        return
    over = Over(over=True)
    try:
        stop(pressed.printers, tell)
    except FarmError as error:
        over = Over(over=True, error=str(error), code=error.code)
    tell(over)
