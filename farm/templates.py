"""Loader of page templates, which escape all text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


def load_environment(
    package: str, filters: Mapping[str, Callable[..., Any]] | None = None, **functions: Callable[..., Any]
) -> Environment:
    """Load and compile all templates of a package.

    All templates are read at once, because an upgrade may replace the files while the daemon is running, and
    a newer template would not match the running program.

    Parameters
    ----------
    package
        Package with a folder `templates`.
    filters, functions
        Filters and functions by name, in addition to Jinja's.

    Returns
    -------
    Environment
        Environment that reads no further files.
    """
    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    environment.filters.update(filters or {})
    environment.globals.update(functions)
    for name in environment.list_templates():
        environment.get_template(name)
    return environment
