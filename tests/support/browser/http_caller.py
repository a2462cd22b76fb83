"""Requests to the daemon's application, whose caller is identified as on the Unix socket."""

import os

from farm.http.callers import Person

DAEMON_USER = Person(os.getuid(), os.getgid())


def call_as(person, app):
    """Wrap the application so that requests come from a person, or from an unidentified caller."""

    async def identify_person(scope, receive, send):
        await app({**scope, "state": {} if person is None else {"caller": person}}, receive, send)

    return identify_person
