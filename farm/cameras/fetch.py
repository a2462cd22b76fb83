"""Fetching of a still over HTTP, within limits on time, size and hosts. Only this module imports httpx.

Cameras' addresses come only from `fleet.yaml`. No message or log line shows such an address, because it may
contain a password.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import socket
import ssl
from contextlib import suppress
from functools import cache
from threading import Thread

import httpx

from farm.cameras.image import MAX_IMAGE_BYTES, Image, InvalidImage, check_beginning, read_image
from farm.cameras.image import CameraError as CameraError

FETCH_TIMEOUT_S = 5.0
"""Wall seconds within which a still must arrive, redirects included."""
_MAX_REDIRECTS = 3
_MAGIC_BYTES = 8

for _name in ("httpx", "httpcore"):  # both log addresses
    logging.getLogger(_name).setLevel(logging.CRITICAL)


async def fetch_still(url: str) -> Image:
    """Fetch a still from a camera.

    Parameters
    ----------
    url
        HTTP or HTTPS address, optionally with `user:password@` for basic or digest authentication.

    Raises
    ------
    CameraError
        If no valid image arrives within `FETCH_TIMEOUT_S`.
    """
    try:
        async with asyncio.timeout(FETCH_TIMEOUT_S):
            return await _fetch_image(httpx.URL(url))
    except TimeoutError:
        raise CameraError(f"it sent no complete still within {FETCH_TIMEOUT_S:g} s") from None
    except InvalidImage as error:
        raise CameraError(str(error)) from None
    except httpx.ConnectError as error:
        text = str(error) if "certificate" in str(error).lower() else "the connection was refused"
        raise CameraError(f"it does not respond ({text})") from None
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, OSError) as error:
        raise CameraError(f"it does not respond like a web server ({type(error).__name__})") from None


async def _fetch_image(url: httpx.URL) -> Image:
    """Fetch an image, and follow redirects to the same host.

    Raises CameraError, InvalidImage, and httpx's errors.
    """
    user, password = url.username, url.password
    authentication: httpx.Auth | None = None
    url = url.copy_with(username=None, password=None)
    addresses = await _look_up_addresses(url)
    async with httpx.AsyncClient(trust_env=False, timeout=None, verify=_make_tls_context()) as client:
        for _ in range(_MAX_REDIRECTS + 2):
            response = await _send_request(client, url, addresses, authentication)
            try:
                if response.status_code == 401 and user and authentication is None:
                    authentication = _choose_authentication(response, user, password)
                elif response.has_redirect_location:
                    url = _resolve_redirect(url, response.headers["location"])
                else:
                    return await _read_response(response)
            finally:
                await response.aclose()
    raise CameraError("it redirects too often")


async def _send_request(
    client: httpx.AsyncClient,
    url: httpx.URL,
    addresses: list[str],
    authentication: httpx.Auth | None,
) -> httpx.Response:
    """Send a request to the first address that accepts a connection. Raises CameraError and httpx's errors.

    The authentication is not left to the client, which would read the body of a response 401 without a limit.
    """
    headers = {"host": url.netloc.decode("ascii"), "accept-encoding": "identity", "connection": "close"}
    for number, address in enumerate(addresses, 1):
        request = client.build_request(
            "GET", url.copy_with(host=address), headers=headers, extensions={"sni_hostname": url.host}
        )
        if authentication is not None:
            request = next(authentication.auth_flow(request))
        try:
            return await client.send(request, stream=True, auth=_keep_request)
        except httpx.ConnectError:
            if number == len(addresses):
                raise
    raise CameraError("its host name has no address")


def _keep_request(request: httpx.Request) -> httpx.Request:
    return request


def _choose_authentication(response: httpx.Response, user: str, password: str) -> httpx.Auth:
    """Return the authentication that a camera requires, digest or basic. Raises CameraError."""
    if not response.headers.get("www-authenticate", "").lower().startswith("digest "):
        return httpx.BasicAuth(user, password)
    digest = httpx.DigestAuth(user, password)
    flow = digest.auth_flow(response.request)
    next(flow)
    try:
        flow.send(response)  # stores the challenge for the next request
    except Exception:  # httpx raises errors of many types for a malformed challenge
        raise CameraError("its authentication is not supported: use basic or digest") from None
    return digest


def _resolve_redirect(url: httpx.URL, location: str) -> httpx.URL:
    """Return the target of a redirect. Raises CameraError if it is on another host or less secure."""
    target = url.join(location).copy_with(username=None, password=None)
    is_secure = target.scheme == "https" or (target.scheme, url.scheme) == ("http", "http")
    if target.host != url.host or not is_secure:
        raise CameraError("it redirects to another host, or from HTTPS to HTTP: give the final address")
    return target


async def _read_response(response: httpx.Response) -> Image:
    """Read the image in a response, up to the limit. Raises CameraError, InvalidImage, and httpx's errors."""
    if response.status_code == 401:
        raise CameraError("it refuses user and password (401): write them as http://USER:PASSWORD@HOST/")
    if response.status_code != 200:
        raise CameraError(f"it answers with the status {response.status_code}")
    content = bytearray()
    async for chunk in response.aiter_raw():
        content += chunk
        check_beginning(bytes(content[:_MAGIC_BYTES]))
        if len(content) > MAX_IMAGE_BYTES:
            break
    return read_image(bytes(content))


@cache
def _make_tls_context() -> ssl.SSLContext:
    """Return a TLS context with the certificates that this host trusts, to which a camera's may be added."""
    return ssl.create_default_context()


async def _look_up_addresses(url: httpx.URL) -> list[str]:
    """Look up the IP addresses of a camera's host.

    If the name server does not answer, a look-up takes half a minute. So it runs in a daemon thread of its
    own: asyncio would use a thread of its pool, which other tasks need, and for which the process waits when
    it exits.

    Raises
    ------
    CameraError
        If the name is unknown.
    """
    loop = asyncio.get_running_loop()
    addresses: asyncio.Future[list[str] | OSError | UnicodeError] = loop.create_future()
    port = url.port or (443 if url.scheme == "https" else 80)

    def look_up() -> None:
        result: list[str] | OSError | UnicodeError
        try:
            rows = socket.getaddrinfo(url.host, port, type=socket.SOCK_STREAM)
            result = list(dict.fromkeys(str(row[4][0]) for row in rows))
        except (OSError, UnicodeError) as error:
            result = error
        with suppress(RuntimeError):  # raised if the loop has ended
            loop.call_soon_threadsafe(set_result, result)

    def set_result(result: list[str] | OSError | UnicodeError) -> None:
        if not addresses.done():
            addresses.set_result(result)

    if _is_address(url.host):
        return [url.host]
    Thread(target=look_up, name="camera look-up", daemon=True).start()
    result = await addresses
    if isinstance(result, list):
        return result
    raise CameraError(f"its name {url.host} is unknown") from result


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
