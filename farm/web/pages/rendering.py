"""Rendering of pages as HTML, from the objects that `--json` prints. The templates escape all text. Pure."""

from __future__ import annotations

from datetime import datetime
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from farm import api
from farm.model import Role
from farm.text import format_duration, format_mass, format_moment

_STATES = {"look": "inspect"}
"""States that the page words differently from `--json`."""


def render_status(status: api.Status, user: str, role: Role, has_session: bool) -> str:
    """Render the farm's status: tasks, printers and jobs.

    Parameters
    ----------
    status
        The farm.
    user, role
        The caller's name and role.
    has_session
        Whether the caller can log out.
    """
    return _render(
        "status.html", status.fleet.name, status=status, user=user, role=role, has_session=has_session
    )


def render_login(farm: str, user: str, role: Role) -> str:
    """Render the page of a link: one button, as a preview of the link must not use it up."""
    return _render("login.html", farm, user=user, role=role)


def render_message(title: str, text: str, has_login_hint: bool = False) -> str:
    """Render a page with a message, such as a refusal.

    Parameters
    ----------
    title, text
        The heading and the message.
    has_login_hint
        Whether the page says how to log in.
    """
    return _render("message.html", title, text=text, has_login_hint=has_login_hint)


def _render(template: str, title: str, **values: object) -> str:
    return load_template(template).render(title=title, **values)


def load_template(name: str) -> Template:
    """Load a template of this folder; it escapes all text."""
    return _templates().get_template(name)


@cache
def _templates() -> Environment:
    environment = Environment(
        loader=PackageLoader("farm.web.pages"), autoescape=True, undefined=StrictUndefined
    )
    environment.filters["duration"] = format_duration
    environment.filters["mass"] = format_mass
    environment.filters["moment"] = _format_moment
    environment.filters["degrees"] = _format_degrees
    environment.filters["state"] = lambda state: _STATES.get(state, state)
    return environment


def _format_moment(at: str | None, now: str) -> str:
    return "" if at is None else format_moment(datetime.fromisoformat(at), datetime.fromisoformat(now))


def _format_degrees(now_c: float | None, target_c: float | None) -> str:
    if now_c is None:
        return "–"
    return f"{now_c:.0f} °C" if not target_c else f"{now_c:.0f} of {target_c:.0f} °C"
