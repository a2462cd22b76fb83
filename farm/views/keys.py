"""View of the keys of network callers and the sessions of browsers, for operators. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from farm import api
from farm.views.context import ViewContext


def list_keys(context: ViewContext, last_uses_s: Mapping[str, float]) -> list[api.KeyView]:
    """List all keys and sessions, the newest last.

    Parameters
    ----------
    context
        The farm.
    last_uses_s
        Time of the last use of each key since the daemon started, by the key's id.
    """
    return [
        api.KeyView(
            id=key.id,
            kind=key.kind,
            name=key.name,
            role=key.role,
            valid=key.is_valid(context.now_s),
            by=key.by,
            created=context.format_time(key.created_s) or "",
            used=context.format_time(last_uses_s.get(key.id)),
            expires=context.format_time(key.expires_s),
            revoked=context.format_time(key.revoked_s),
        )
        for key in sorted(context.books.keys.values(), key=lambda key: key.created_s)
    ]
