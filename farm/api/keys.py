"""Requests and responses about keys of callers on the network, and about sessions of browsers."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from farm.api.base import SCHEMA, View
from farm.model import KeyKind, Role


class KeyRequest(View):
    """Request for a key, which expires after `days`, or never if that is None."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,40}$")]
    role: Role = Role.PRINT
    days: Annotated[float, Field(gt=0, le=36_500)] | None = None


class NewKey(View):
    """Key that was added. Only this response has the key's text, because the farm does not store the text."""

    id: str
    text: str
    role: Role


class KeyView(View):
    """Key of a caller on the network, or session of a browser."""

    id: str
    kind: KeyKind
    name: str
    role: Role
    valid: bool
    by: str  # operator who added it
    created: str
    used: str | None  # last use since the daemon started
    expires: str | None
    revoked: str | None


class AppKeyGrant(View):
    """Grant of a key to a program that has requested it."""

    role: Role = Role.PRINT
    days: Annotated[float, Field(gt=0, le=36_500)] | None = None


class AppKeyRequestView(View):
    """Request for a key by a program."""

    code: str
    app: str  # name of the program, as it states it
    address: str


class NetworkView(View):
    """Server for callers on the network (`web` in fleet.yaml)."""

    address: str | None  # null if it is off
    problem: str | None  # reason why it does not listen


class Keys(View):
    """Response to `farm key --json`."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)
    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    network: NetworkView
    keys: list[KeyView]
    requests: list[AppKeyRequestView] = Field(default_factory=list)


class LoginLink(View):
    """Response to `farm web --json`: a link that opens one session in a browser."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)
    schema_: int = Field(default=SCHEMA, alias="schema")
    url: str
    user: str
    role: Role
    valid_s: float  # wall seconds


class EndedSessions(View):
    """Response to `farm web --end-all --json`."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)
    schema_: int = Field(default=SCHEMA, alias="schema")
    ended: int
