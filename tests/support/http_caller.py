"""Requests to the daemon's application, with a caller as the kernel identifies one on the Unix socket."""

import os

from farm.http.callers import Person

DAEMON_USER = Person(os.getuid(), os.getgid())


def called_by(person, app):
    """Return the application as a person on the Unix socket reaches it; nobody if None."""

    async def as_person(scope, receive, send):
        await app({**scope, "state": {} if person is None else {"person": person}}, receive, send)

    return as_person
