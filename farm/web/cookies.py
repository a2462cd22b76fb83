"""Cookie of a browser's session."""

from __future__ import annotations

from dataclasses import dataclass

from starlette.requests import cookie_parser
from starlette.responses import Response

from farm.config import WebSection
from farm.control import MAX_SESSION_S


@dataclass(frozen=True, slots=True)
class SessionCookie:
    """Cookie that scripts cannot read, and that browsers do not send with a form from another site.

    Its value is the key text of the session: the secret by which the farm recognises the session.

    `SameSite` is `Lax`, so that a link in a message opens the farm's pages with the user's session;
    `farm.web.request_checks` checks requests that change the farm. With HTTPS, the prefix `__Host-` prevents
    other hosts of the domain from setting the cookie.

    Attributes
    ----------
    port
        The server's port. It is part of the cookie's name, because browsers send a host's cookies to all
        of its ports.
    is_encrypted
        True if browsers reach the farm by HTTPS.
    """

    port: int
    is_encrypted: bool

    @classmethod
    def for_section(cls, section: WebSection | None) -> SessionCookie:
        """Return the cookie of the server that the section `web` of fleet.yaml describes."""
        section = section or WebSection()
        return cls(section.address[1], section.is_encrypted)

    @property
    def name(self) -> str:
        """The cookie's name."""
        return f"{'__Host-' if self.is_encrypted else ''}farm-{self.port}"

    def read(self, header: str) -> str:
        """Return the key text of the session in the header `Cookie`; empty if there is none."""
        return cookie_parser(header).get(self.name, "")

    def set(self, response: Response, key_text: str) -> None:
        """Store a session's key text in the browser. The farm, not the cookie's age, ends the session."""
        self._write_cookie(response, key_text, int(MAX_SESSION_S))

    def clear(self, response: Response) -> None:
        """Remove the session's key text from the browser."""
        self._write_cookie(response, "", 0)

    def _write_cookie(self, response: Response, key_text: str, max_age_s: int) -> None:
        response.set_cookie(
            self.name,
            key_text,
            max_age_s,
            path="/",
            secure=self.is_encrypted,
            httponly=True,
            samesite="lax",
        )
