"""Scripts that verify the printer at the port, as swapped cables must not heat the wrong printer. Pure."""

from __future__ import annotations

from drivers.errors import Fault
from drivers.firmware import Identity
from drivers.session.commands import MAX_ATTEMPTS, connect, query, send
from drivers.session.context import PrintEnded, Script, SessionContext

HOME_TOLERANCE_MM = 30.0  # M206 shifts the Z coordinate of the home position


def identify_printer(context: SessionContext) -> Script:
    """Reset the board and verify that it belongs to this printer, before anything heats.

    A banner has no checksum, so an unreadable or unexpected banner is requested again.
    """
    firmware, profile = context.firmware, context.profile
    problem = ""
    for _ in range(MAX_ATTEMPTS):
        yield from connect(context)
        assert context.connection is not None
        identity = firmware.read_identity(context.connection.banner)
        if not context.connection.has_restarted or firmware.version_pattern is None:
            # The home height identifies an Extended; other models answer `identity_query`.
            offset = firmware.read_offset((yield from query(context, firmware.settings_query)))
            identity = None if offset is None else Identity(profile.banner_suffix, offset)
        if identity is None:
            source = "banner does not say" if firmware.version_pattern is not None else "settings do not say"
            problem = f"its {source} which printer it is"
        elif identity.suffix != profile.banner_suffix:
            problem = f"its banner is not that of the model {profile.title}"
        elif context.identity is not None and identity.offset != context.identity:
            offsets = f"home offset {identity.offset}, not {context.identity}"
            problem = f"another printer, or levelled again: {offsets}"
        else:
            answer = yield from query(context, firmware.identity_query)
            if firmware.identity_text not in answer:
                problem = f"M115 reports a firmware other than {firmware.title}"
            elif profile.machine_text not in answer:
                problem = f"M115 reports a machine other than the {profile.title}"
            else:
                context.identity = identity.offset
                return
    raise PrintEnded(Fault.WRONG_PRINTER, problem)


def check_height(context: SessionContext, home_command: bytes) -> Script:
    """Verify the Z of the home position of this model; `home_command` is the first G28 of the file.

    An Extended is 100 mm taller, even if its firmware reports otherwise.
    """
    if home_command != b"G28" and b"Z" not in home_command:
        return
    context.position_mm = None
    yield from send(context, context.firmware.position_query)
    home_mm = context.profile.home_mm[2]
    if context.position_mm is not None and abs(context.position_mm[2] - home_mm) > HOME_TOLERANCE_MM:
        raise PrintEnded(
            Fault.WRONG_PRINTER,
            f"its bed homes at {context.position_mm[2]:g} mm, not near {home_mm:g}: "
            f"it is not the model {context.profile.title}",
        )
