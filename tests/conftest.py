"""Run property tests without a deadline, because an example that is slow on a busy machine is not wrong."""

from __future__ import annotations

from hypothesis import settings

# On CI, `settings.default` is the CI profile.
settings.register_profile("no deadline", settings.default, deadline=None)
settings.load_profile("no deadline")
