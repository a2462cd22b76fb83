"""Rendering of pages as HTML, from the objects that `--json` prints. The templates escape all text. Pure."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Protocol

from jinja2 import Environment, Template
from markupsafe import Markup

from farm import api
from farm.model import JobState, PrintState, Role
from farm.templates import load_environment
from farm.text import format_duration, format_mass
from farm.web.notes import Note, User
from farm.web.pages.sentences import (
    format_commands,
    format_sentence,
    format_time_attributes,
    format_time_element,
)
from farm.web.pages.static_files import load_static_files, make_static_url
from farm.wording import describe_material, format_deviation, format_share

NAVIGATION: tuple[tuple[str, str, Role], ...] = (
    ("/", "Home", Role.LOOK),
    ("/submit", "Submit", Role.PRINT),
    ("/timeline", "Timeline", Role.LOOK),
    ("/history", "History", Role.LOOK),
)
"""Links of the navigation, each with the path of a page, a label, and the role that the page requires."""
_VALUE_TEXTS = {
    "look": "inspect",  # state of a printer that a person must inspect; unrelated to `Role.LOOK`
    "ready": "idle",
    "absent": "not connected",
    "at_nozzle": "at the nozzle",
    "not_clear": "not clear",
}
"""Texts for values whose names on the pages differ from those in `--json`."""
_GLYPHS = {
    "printing": "▶",
    "heating": "▲",
    "paused": "‖",
    "idle": "○",
    "done": "✓",
    "printed": "✓",
    "good": "✓",
    "bad": "✕",
    "planned": "…",
    "look": "!",
    "fault": "!",
    "failed": "✕",
    "absent": "✕",
}
_OTHER_GLYPH = "•"


class FleetInfo(Protocol):
    """Object with the name and time zone of the fleet: a section of `fleet.yaml`, or `api.FleetView`."""

    @property
    def name(self) -> str: ...

    @property
    def timezone(self) -> str: ...


def render_page(
    template: str, fleet: FleetInfo, path: str, user: User, note: Note | None = None, **values: object
) -> str:
    """Render a page with its navigation.

    Parameters
    ----------
    template
        Name of a file in `templates` that extends `page.html`.
    fleet
        The fleet.
    path
        Path of the page, whose link is marked in the navigation.
    user
        User of the page.
    note
        Message about the user's last action.
    values
        Variables of the template.
    """
    links = [(page_path, label) for page_path, label, role in NAVIGATION if user.role.allows(role)]
    return load_template(template).render(fleet=fleet, path=path, links=links, user=user, note=note, **values)


def render_login(farm_name: str, user: str, role: Role) -> str:
    """Render the page that a login link opens.

    Only the button on the page logs the user in, and uses up the link: a program that opens the link for a
    preview leaves it valid.
    """
    return load_template("login.html").render(title=farm_name, user=user, role=role)


def render_message(title: str, text: str, has_login_hint: bool = False) -> str:
    """Render a page with a message, such as a refusal.

    Parameters
    ----------
    title, text
        The heading and the message.
    has_login_hint
        True if the page explains how to log in.
    """
    return load_template("message.html").render(title=title, text=text, has_login_hint=has_login_hint)


def load_template(name: str) -> Template:
    """Load a template of this package; all templates escape text."""
    return load_templates().get_template(name)


def load_page_files() -> None:
    """Load all templates and static files."""
    load_templates()
    load_static_files()


@cache
def load_templates() -> Environment:
    """Load all templates of this package; later calls return the same environment."""
    filters: dict[str, Callable[..., str]] = {
        "duration": format_duration,
        "mass": format_mass,
        "moment": format_time_element,
        "degrees": _format_degrees,
        "material": describe_material,
        "share": partial(_format_optional_value, format_share),
        "deviation": partial(_format_optional_value, format_deviation),
        "commands": format_commands,
        "sentence": format_sentence,
        "time_attributes": format_time_attributes,
        "words": describe_value,
        "state": format_state,
        "job_state": format_job_state,
        "outcome": format_outcome,
    }
    return load_environment("farm.web.pages", filters, asset=make_static_url)


def format_state(state: str) -> Markup:
    """Format a state as a label with a symbol and text, because not everybody can distinguish colours."""
    glyph = _GLYPHS.get(state, _OTHER_GLYPH)
    return Markup('<span class="state {}"><span aria-hidden="true">{}</span> {}</span>').format(
        state, glyph, describe_value(state)
    )


def format_job_state(job: api.JobView) -> Markup:
    """Format the state of a job; a job in state `printing` without an open print is shown as waiting."""
    is_waiting = job.state is JobState.PRINTING and not any(plate.printing for plate in job.plates)
    return format_state("paused" if job.paused else "waiting" if is_waiting else job.state)


def format_outcome(attempt: api.HistoryRow) -> Markup:
    """Format the outcome of a print: the verdict on its part, or otherwise its state."""
    state = "printed" if attempt.state is PrintState.DONE else attempt.state
    return format_state(attempt.verdict or state)


def describe_value(value: str) -> str:
    """Return the text that pages show for a value of an enumeration."""
    return _VALUE_TEXTS.get(value, value.replace("_", " "))


def _format_optional_value(format_value: Callable[[float], str], value: float | None) -> str:
    return "–" if value is None else format_value(value)


def _format_degrees(now_c: float | None, target_c: float | None) -> str:
    if now_c is None:
        return "–"
    return f"{now_c:.0f} °C" if not target_c else f"{now_c:.0f} of {target_c:.0f} °C"
