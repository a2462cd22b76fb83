"""Identification and permissions of callers, and the daemon's Unix socket."""

from __future__ import annotations

import asyncio
import grp
import logging
import os
import pwd
import socket
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol

import h11
from fastapi import Depends, Request
from uvicorn.protocols.http.h11_impl import H11Protocol

from farm.errors import FleetFileError, RefusedError
from farm.model import Role

log = logging.getLogger(__name__)
_BACKLOG = 1024  # queued connections use no descriptor; further ones are refused
_UID_PREFIX = "uid "  # prefix of the name of a user who is not in the user database
_NO_GID = -1
_CREDENTIALS = struct.Struct("=iII")  # struct ucred: pid, uid, gid


class Caller(Protocol):
    """Sender of a request: a user of this host, or a key on the network."""

    @property
    def name(self) -> str:
        """Name for the event log, and for other people."""

    def is_operator(self, group: str | None) -> bool:
        """Return whether the caller is an operator; `group` is `fleet.operators`."""


@dataclass(frozen=True, slots=True)
class Person:
    """User of this host who calls the daemon."""

    uid: int
    gid: int

    @property
    def name(self) -> str:
        """Name in the user database."""
        try:
            return pwd.getpwuid(self.uid).pw_name
        except KeyError:
            return f"{_UID_PREFIX}{self.uid}"

    def is_operator(self, group: str | None) -> bool:
        """Return whether the person is an operator.

        Root and the daemon's user are always operators, because they could change the database anyway.
        """
        return group is None or self.uid in (0, os.getuid()) or self.belongs_to(group)

    def belongs_to(self, group: str) -> bool:
        """Return whether the person is a member of a group, or called from a process with that group."""
        gid = _find_gid(group)
        try:
            return gid in (self.gid, *os.getgrouplist(pwd.getpwuid(self.uid).pw_name, self.gid))
        except KeyError:  # the user is not in the database
            return gid == self.gid


def find_session_role(caller: Caller, operator_group: str | None) -> Role:
    """Return the role of a caller's browser sessions; `operator_group` is `fleet.operators`."""
    return Role.OPERATE if caller.is_operator(operator_group) else Role.PRINT


def find_user_role(name: str, operator_group: str | None) -> Role | None:
    """Return a user's current role by the user and group databases; None if the user was deleted.

    Parameters
    ----------
    name
        Name of the user, as in `Person.name`.
    operator_group
        The group `fleet.operators`; None if every user is an operator.
    """
    if name.startswith(_UID_PREFIX):
        person = Person(int(name.removeprefix(_UID_PREFIX)), _NO_GID)
    else:
        try:
            user = pwd.getpwnam(name)
        except KeyError:
            return None
        person = Person(user.pw_uid, user.pw_gid)
    return find_session_role(person, operator_group)


class PeerProtocol(H11Protocol):
    """HTTP protocol that sets `request.state.caller` to the user at the other end of a Unix socket.

    It also records when it began to wait for the client to send the rest of a request or to read the
    response, because the server closes connections that wait too long.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._waiting_since_s = self.loop.time()
        peer: socket.socket | None = transport.get_extra_info("socket")
        if peer is not None and peer.family == socket.AF_UNIX:
            credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
            _, uid, gid = _CREDENTIALS.unpack(credentials)
            self.app_state: dict[str, Any] = {**self.app_state, "caller": Person(uid, gid)}

    def data_received(self, data: bytes) -> None:
        previous_state = self.conn.their_state
        super().data_received(data)
        if self.conn.their_state is h11.SEND_BODY or self.conn.their_state is not previous_state:
            # the time limit applies to the whole head, and to each chunk of a body
            self._waiting_since_s = self.loop.time()

    def on_response_complete(self) -> None:
        self._waiting_since_s = self.loop.time()
        super().on_response_complete()

    def pause_writing(self) -> None:
        self._unread_since_s = self.loop.time()
        super().pause_writing()

    @property
    def waiting_since_s(self) -> float | None:
        """Time at which the wait for the client began, on the loop's clock; None if there is no wait."""
        if self.flow.write_paused:
            return self._unread_since_s
        is_waiting = self.conn.their_state in (h11.IDLE, h11.SEND_BODY) and not self.flow.read_paused
        return self._waiting_since_s if is_waiting else None


def identify_caller(request: Request) -> Caller:
    """Return the caller: a user identified by the kernel, or a key on the network.

    Raises
    ------
    RefusedError
        If the sender is unknown.
    """
    caller: Caller | None = getattr(request.state, "caller", None)
    if caller is None:
        raise RefusedError("the sender of this request is unknown: use the daemon's Unix socket")
    return caller


def find_caller_name(request: Request) -> str:
    """Return the name of the caller. Raises RefusedError if the sender is unknown."""
    return identify_caller(request).name


def is_operator(request: Request) -> bool:
    """Return whether the caller is an operator. Raises RefusedError if the sender is unknown."""
    return identify_caller(request).is_operator(_find_operator_group(request))


def find_operator_name(request: Request) -> str:
    """Return the name of a caller who is an operator. Raises RefusedError for others."""
    name = identify_caller(request).name
    if is_operator(request):
        return name
    group = _find_operator_group(request)
    raise RefusedError(f"{name} is not an operator: only members of the group {group} may do this")


def _find_operator_group(request: Request) -> str | None:
    group: str | None = request.app.state.controller.fleet.fleet.operators
    return group


def check_operator_group(group: str | None) -> None:
    """Raise FleetFileError if `fleet.operators` names a group that this host does not have."""
    if group is not None and _find_gid(group) is None:
        raise FleetFileError(f"fleet.operators: there is no group {group}; `groupadd {group}` creates it")


def listen(path: Path, group: str) -> socket.socket:
    """Open a listening Unix socket for a group, or for this user alone if the group does not exist.

    Raises
    ------
    RefusedError
        If the socket cannot be opened.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # the lock on the state folder rules out another daemon of this farm
        mask = os.umask(0o177)
        try:
            listener.bind(str(path))
        finally:
            os.umask(mask)
    except OSError as error:
        listener.close()
        raise RefusedError(
            f"{path}: the daemon cannot listen there ({error}); name another --socket"
        ) from error
    _share_socket(path, group)
    listener.listen(_BACKLOG)
    listener.setblocking(False)
    return listener


def _share_socket(path: Path, group: str) -> None:
    """Share a socket with a group; if that fails, log the reason why only its owner may use it."""
    gid = _find_gid(group)
    if gid is None:
        log.info("listening on %s, for this user alone: there is no group %s", path, group)
        return
    try:
        os.chown(path, -1, gid)
        path.chmod(0o660)
    except OSError as error:
        log.warning(
            "listening on %s, for this user alone: it cannot be shared with group %s (%s)", path, group, error
        )
    else:
        log.info("listening on %s, for group %s", path, group)


def _find_gid(group: str) -> int | None:
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        return None


CallerName = Annotated[str, Depends(find_caller_name)]
"""Parameter of a route that every user may call: the name of the caller."""
OperatorName = Annotated[str, Depends(find_operator_name)]
"""Parameter of a route for operators only (`fleet.operators`): the name of the caller."""
