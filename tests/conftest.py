"""Property tests without a deadline: a busy machine makes an example slow, not wrong."""

from __future__ import annotations

from hypothesis import settings

# `settings.default` is the profile of CI where that is active.
settings.register_profile("no deadline", settings.default, deadline=None)
settings.load_profile("no deadline")
