"""Requests to the daemon's application, with a caller identified as on the Unix socket."""

import os

from farm.http.callers import Person

DAEMON_USER = Person(os.getuid(), os.getgid())


def call_as(person, app):
    """Wrap the application so that requests come from a person on the Unix socket, or from nobody if None."""

    async def identify_person(scope, receive, send):
        await app({**scope, "state": {} if person is None else {"caller": person}}, receive, send)

    return identify_person
