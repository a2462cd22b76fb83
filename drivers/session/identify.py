"""Scripts that see which printer a session talks to: two swapped cables must not heat the wrong one. Pure."""

from __future__ import annotations

from drivers.errors import Fault
from drivers.firmware import Identity
from drivers.session.commands import TRIES, ask, connect, send
from drivers.session.context import Ended, Script, SessionContext

HOME_SLACK_MM = 30.0  # M206 shifts what a printer calls the height of its home


def identify(context: SessionContext) -> Script:
    """Reset the board and see that it is this printer's; before anything heats.

    A banner carries no checksum: what cannot be read, or is another's, is asked for again.
    """
    firmware, profile = context.firmware, context.profile
    wrong = ""
    for _ in range(TRIES):
        yield from connect(context)
        assert context.greeting is not None
        found = firmware.read_identity(context.greeting.banner)
        if not context.greeting.restarted or firmware.version is None:
            # the height of its home tells an Extended; others are told by the answer to `identity_query`
            offset = firmware.read_offset((yield from ask(context, firmware.settings_query)))
            found = None if offset is None else Identity(profile.banner_suffix, offset)
        if found is None:
            says = "banner does not tell" if firmware.version is not None else "settings do not tell"
            wrong = f"its {says} which printer it is"
        elif found.suffix != profile.banner_suffix:
            wrong = f"not the board of an {profile.title}"
        elif context.identity is not None and found.offset != context.identity:
            offsets = f"home offset {found.offset}, not {context.identity}"
            wrong = f"another printer, or levelled anew: {offsets}"
        else:
            answer = yield from ask(context, firmware.identity_query)
            if firmware.identity_word not in answer:
                wrong = f"M115 tells of another firmware than the {firmware.title}'s"
            elif profile.machine_word not in answer:
                wrong = f"M115 tells of another machine than the {profile.title}"
            else:
                context.identity = found.offset
                return
    raise Ended(Fault.WRONG_PRINTER, wrong)


def check_height(context: SessionContext, home: bytes) -> Script:
    """See that the bed homes where this model's does; `home` is the file's first G28.

    An Extended is 100 mm higher, whatever its firmware says.
    """
    if home != b"G28" and b"Z" not in home:
        return
    context.position = None
    yield from send(context, context.firmware.position_query)
    home_mm = context.profile.home_mm[2]
    if context.position is not None and abs(context.position[2] - home_mm) > HOME_SLACK_MM:
        raise Ended(
            Fault.WRONG_PRINTER,
            f"its bed homes at {context.position[2]:g} mm, not near {home_mm:g}: "
            f"not an {context.profile.title}",
        )
