"""Random requests to the farm's server for the network: every route, hostile values, broken framing.

A third of the requests are plain and valid. Others are well-formed HTTP for a known route with valid or
hostile values, or have damaged heads, lengths, chunks or bytes. The same random seed gives the same requests.
All functions are pure.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from farm.api import NETWORK_PREFIX
from farm.web.access import HOST_ONLY_ROUTES, PUBLIC_ROUTES, ROLES

HOST = "localhost"
ROUTES = sorted({*ROLES, *PUBLIC_ROUTES, *HOST_ONLY_ROUTES})
HOSTILE_VALUES = (
    "", "0", "-1", "1e999", "9" * 400, "nan", "null", "true", "\x00", "\u202e", "ü" * 300, "../../etc/passwd",
    "..%2f..%2fetc%2fpasswd", "%00", "%ff%fe", "{{7*7}}", "';DROP TABLE event;--", "<script>",
    "\r\nX-Injected: 1", "a" * 5000, "p01/../../down", ".", "..", "/", "\\\\host\\share", "\ud800",
)  # fmt: skip
VALID_VALUES = {
    "number": "1",
    "name": "a",
    "printer": "a",
    "part": "p01",
    "request_id": "r" * 8,
    "token": "t" * 8,
}
BODY_FIELDS = (
    "why", "bad", "good", "filament", "material", "colour", "grams", "nozzle_mm", "plan", "to", "before",
    "now",
    "wait", "dry_run", "command", "print", "select", "role", "days", "user", "options", "quality", "printers",
)  # fmt: skip
QUERY_FIELDS = (
    "request_id", "name", "size", "options", "job", "printer", "last", "since", "apikey", "path", "force",
)  # fmt: skip
STL = b"solid a\n" + b"".join(
    b"facet normal 0 0 0\nouter loop\nvertex %b\nvertex %b\nvertex %b\nendloop\nendfacet\n" % corners
    for corners in (
        (b"0 0 0", b"9 0 0", b"0 9 0"), (b"0 0 0", b"0 9 0", b"0 0 9"),
        (b"0 0 0", b"0 0 9", b"9 0 0"), (b"9 0 0", b"0 0 9", b"0 9 0"),
    )
) + b"endsolid a\n"  # fmt: skip
GCODE = b";FLAVOR:Marlin\nG28\nM104 S200\nG1 X10 Y10 E1\n"
_METHODS = ("GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH", "TRACE", "CONNECT", "get", "P\x00ST")
_SUBMIT_ROUTE = f"{NETWORK_PREFIX}/jobs"
_PLAIN_SHARE = 0.3
_PLAIN_BODIES = (b"{}", b'{"why": "x"}', b'{"grams": 500, "colour": "red"}', b'{"bad": true, "why": "x"}')
_ENCODING = "surrogatepass"


@dataclass(frozen=True, slots=True)
class FuzzedRequest:
    """Request as bytes.

    Attributes
    ----------
    caller
        Name of its key; `nobody` has none.
    method, path
        Route that it requests, before any damage.
    intact
        True if a server must answer it.
    """

    data: bytes
    caller: str
    method: str
    path: str
    intact: bool


def make_request(rng: random.Random, keys: Mapping[str, str]) -> FuzzedRequest:
    """Make a request by one of the callers.

    Parameters
    ----------
    rng
        Source of every choice.
    keys
        Texts of the callers' keys, by name; an empty string for nobody.
    """
    caller = rng.choice(sorted(keys))
    method, template = rng.choice(ROUTES)
    is_plain = rng.random() < _PLAIN_SHARE
    if rng.random() < 0.05:
        method = rng.choice(_METHODS)
    path = _fill_path(rng, template, 1.0 if is_plain else 0.8)
    body, media_type = (rng.choice(_PLAIN_BODIES), "application/json") if is_plain else _make_body(rng)
    if is_plain and template == _SUBMIT_ROUTE:
        body, media_type = STL, "application/octet-stream"
        path = f"{template}?request_id={rng.getrandbits(64):016x}&name=a.stl&size={len(body)}"
    headers = {"Host": HOST, "Connection": "close", "Content-Type": media_type}
    if not is_plain:
        headers |= _make_headers(rng)
    if keys[caller]:
        name = rng.choice(("X-Api-Key", "x-api-key", "Authorization"))
        headers[name] = f"Bearer {keys[caller]}" if name == "Authorization" else keys[caller]
    if method == "GET":
        body = b""
    damage = None if is_plain else rng.choice((None,) * 8 + _DAMAGES)
    if damage is None:
        headers["Content-Length"] = str(len(body))
        data = _write_head(method, path, headers) + body
    else:
        data = damage(rng, method, path, headers, body)
    is_intact = damage is None and method in ("GET", "POST") and not _is_invalid(path, headers)
    return FuzzedRequest(data, caller, method, template, is_intact)


def _is_invalid(path: str, headers: Mapping[str, str]) -> bool:
    """Check whether a head cannot be parsed as HTTP, so that the server may close the connection."""
    return any(not " " < char <= "~" for char in path) or any(
        not (char == "\t" or " " <= char <= "~") for value in headers.values() for char in value
    )


def _fill_path(rng: random.Random, template: str, valid_share: float) -> str:
    """Fill in the parameters of a path, and add a query."""
    path = template
    for name, value in VALID_VALUES.items():
        path = path.replace(
            f"{{{name}}}", value if rng.random() < valid_share else rng.choice(HOSTILE_VALUES)
        )
    if rng.random() < (1.0 - valid_share) / 6.0:
        path = rng.choice(HOSTILE_VALUES)
    if not path.startswith("/"):
        path = f"/{path}"
    if template == _SUBMIT_ROUTE and rng.random() < 0.7:
        name = rng.choice(("a.stl", "a.gcode", "a.3mf", "a.obj", "../a.stl", "ü.stl", "a" * 150))
        size = rng.choice((0, 1, len(GCODE), len(STL), 10**15))
        return f"{path}?request_id={rng.getrandbits(64):016x}&name={name}&size={size}"
    query = [
        f"{rng.choice(QUERY_FIELDS)}={rng.choice((*HOSTILE_VALUES, '1', 'a'))}"
        for _ in range(rng.randrange(3))
    ]
    has_query = query and rng.random() > valid_share
    return f"{path}?{'&'.join(query)}" if has_query else path


def _make_headers(rng: random.Random) -> dict[str, str]:
    """Make headers that the server reads."""
    candidates = {
        "Origin": (f"http://{HOST}", "http://evil.example", "null", ""),
        "Sec-Fetch-Site": ("same-origin", "cross-site", "none", "x"),
        "Host": (HOST, "evil.example", "127.0.0.1:1", "[::1]", "", "a b", "localhost:99999999"),
        "Accept": ("text/html", "application/json", "*/*", ""),
        "Cookie": ("farm_session=x", "__Host-farm_session=farm_x_y", ";;;=", "a=" + "b" * 3000),
        "Last-Event-ID": ("0", "-1", "9" * 30, "x"),
        "Accept-Encoding": ("gzip", "br;q=0", "*"),
        "Expect": ("100-continue", "200-ok"),
        "Range": ("bytes=0-", "bytes=-1", "x"),
        "If-None-Match": ("*", '"x"'),
        "X-Forwarded-For": ("127.0.0.1",),
        "Upgrade": ("websocket", "h2c"),
        "X-Api-Key": HOSTILE_VALUES,
        "Authorization": ("Bearer", "Bearer x", "Basic eDp5", "Digest x"),
    }
    names = rng.sample(sorted(candidates), rng.choice((0, 0, 0, 1, 2, 4)))
    return {name: rng.choice(candidates[name]) for name in names}


def _make_body(rng: random.Random) -> tuple[bytes, str]:
    """Make a body, and its media type."""
    kind = rng.randrange(8)
    if kind in (0, 6, 7):
        return (b"" if kind == 0 else rng.choice((b"{}", b'{"why": "x"}'))), "application/json"
    if kind <= 2:
        value = {rng.choice(BODY_FIELDS): _make_value(rng, 3) for _ in range(rng.randrange(4))}
        return json.dumps(value if rng.random() < 0.9 else _make_value(rng, 3)).encode(), "application/json"
    if kind == 3:
        return _make_form(rng)
    if kind == 4:
        return rng.choice((STL, GCODE)), "application/octet-stream"
    return rng.randbytes(rng.choice((1, 10, 1000))), rng.choice(("application/json", "text/plain", "x/y", ""))


def _make_value(rng: random.Random, depth: int) -> Any:
    """Make a JSON value."""
    kind = rng.randrange(8 if depth else 6)
    if kind == 6:
        return [_make_value(rng, depth - 1) for _ in range(rng.randrange(4))]
    if kind == 7:
        return {rng.choice((*BODY_FIELDS, "x")): _make_value(rng, depth - 1) for _ in range(rng.randrange(4))}
    number = rng.choice((0, 1, -1, 2**63, 10**400, 0.5, float("inf"), float("nan"), -1e308))
    return (None, rng.random() < 0.5, number, rng.choice(HOSTILE_VALUES), "a", "p01")[kind]


def _make_form(rng: random.Random) -> tuple[bytes, str]:
    """Make a form as slicers send it, with fields in any order, some of them broken."""
    boundary = rng.choice(("xyz", "boundary_.oOo._x", "-" * 70, ""))
    parts = []
    for _ in range(rng.randrange(5)):
        name = rng.choice(("file", "print", "select", "path", "root", "x", *HOSTILE_VALUES[:6]))
        file_name = rng.choice(
            ("", '; filename="a.gcode"', '; filename="../a.stl"', "; filename*=UTF-8''a.3mf")
        )
        content = rng.choice((b"true", b"false", GCODE, STL, b"", rng.randbytes(50)))
        head = f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"{file_name}\r\n\r\n'
        parts.append(head.encode(errors=_ENCODING) + content + b"\r\n")
    end = rng.choice((f"--{boundary}--\r\n", f"--{boundary}", "", f"--{boundary}--\r\ntrailing"))
    media_type = f'multipart/form-data; boundary="{boundary}"' if rng.random() < 0.5 else (
        f"multipart/form-data; boundary={boundary}"
    )  # fmt: skip
    return b"".join(parts) + end.encode(), media_type


def _write_head(method: str, path: str, headers: Mapping[str, str], version: str = "HTTP/1.1") -> bytes:
    lines = [f"{method} {path} {version}", *(f"{name}: {value}" for name, value in headers.items())]
    return ("\r\n".join(lines) + "\r\n\r\n").encode(errors=_ENCODING)


def _damage_length(rng: random.Random, method: str, path: str, headers: dict[str, str], body: bytes) -> bytes:
    """Send a wrong length of the body."""
    length = rng.choice(("-1", "1" * 30, "x", "", "0", str(len(body) + 10), "5, 6"))
    return _write_head(method, path, {**headers, "Content-Length": length}) + body


def _damage_chunks(rng: random.Random, method: str, path: str, headers: dict[str, str], body: bytes) -> bytes:
    """Send chunks, some of them wrong, some in addition to a length."""
    added_headers = {"Transfer-Encoding": rng.choice(("chunked", "gzip, chunked", "x"))}
    if rng.random() < 0.3:
        added_headers["Content-Length"] = str(len(body))
    size = rng.choice((f"{len(body):x}", "-1", "ffffffffffffffff", "x", f"{len(body):x};ext=1"))
    end = rng.choice(("\r\n0\r\n\r\n", "\r\n0\r\nTrailer: x\r\n\r\n", "", "0"))
    return (
        _write_head(method, path, {**headers, **added_headers}) + f"{size}\r\n".encode() + body + end.encode()
    )


def _damage_head(rng: random.Random, method: str, path: str, headers: dict[str, str], body: bytes) -> bytes:
    """Write a head that is too long, has an old or an unknown version, or wrong line ends."""
    kind = rng.randrange(5)
    if kind == 0:
        return _write_head(method, path, {**headers, "X-Long": "a" * rng.choice((20_000, 200_000))}) + body
    if kind == 1:
        return _write_head(method, path, {f"X-{i}": "y" for i in range(500)} | headers) + body
    if kind == 2:
        return _write_head(method, path, headers, rng.choice(("HTTP/1.0", "HTTP/2", "HTTP/9.9", ""))) + body
    data = _write_head(method, path, {**headers, "Content-Length": str(len(body))}) + body
    return (
        data.replace(b"\r\n", b"\n") if kind == 3 else data.replace(b": ", b":", 1).replace(b"Host", b"H\0st")
    )


def _damage_bytes(rng: random.Random, method: str, path: str, headers: dict[str, str], body: bytes) -> bytes:
    """Change bytes at random positions."""
    data = bytearray(_write_head(method, path, {**headers, "Content-Length": str(len(body))}) + body)
    for _ in range(rng.choice((1, 1, 2, 10))):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def _cut_request(rng: random.Random, method: str, path: str, headers: dict[str, str], body: bytes) -> bytes:
    """Cut off a request at a random position."""
    data = _write_head(method, path, {**headers, "Content-Length": str(len(body))}) + body
    return data[: rng.randrange(len(data))]


def _repeat_request(
    rng: random.Random, method: str, path: str, headers: dict[str, str], body: bytes
) -> bytes:
    """Send several requests at once on one connection."""
    open_headers = {**headers, "Content-Length": str(len(body)), "Connection": "keep-alive"}
    last_headers = {**headers, "Content-Length": str(len(body))}
    requests = (_write_head(method, path, open_headers) + body) * rng.choice((1, 2, 20))
    return requests + _write_head(method, path, last_headers) + body


_DAMAGES = (
    _damage_length,
    _damage_chunks,
    _damage_head,
    _damage_bytes,
    _damage_bytes,
    _cut_request,
    _repeat_request,
)


def list_statuses(answer: bytes) -> Iterable[int]:
    """List the statuses of the answers on one connection."""
    for line in answer.split(b"HTTP/1.1 ")[1:]:
        if line[:3].isdigit():
            yield int(line[:3])
